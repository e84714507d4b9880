"""`export`: writes a sound's mouth shapes, blendshapes or visemes for avatars and cartoons."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from lipservo.commands.options import (
    DEFAULT_FACE,
    Alphabet,
    Channel,
    Config,
    Json,
    Model,
    Phonemes,
    SpokenText,
    Tier,
    label_file,
)
from lipservo.commands.run.motion_choice import takes_motion
from lipservo.commands.run.voice_choice import spoken_text
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.terminal.output import MESSAGES, print_json
from lipsync.errors import UserError

Format = Literal["rhubarb", "arkit", "ovr"]
ShapeSource = Literal["motion", "rules"]

#: What the ending of a file's name means where no --format says otherwise.
_FORMAT_OF: dict[str, Format] = {
    ".tsv": "rhubarb", ".json": "rhubarb", ".xml": "rhubarb", ".jsonl": "arkit", ".csv": "arkit",
}  # fmt: skip
_ENDINGS: dict[Format, tuple[str, ...]] = {
    "rhubarb": (".tsv", ".json", ".xml"), "arkit": (".jsonl", ".csv"), "ovr": (".jsonl", ".csv"),
}  # fmt: skip
#: How files begin that this command or Rhubarb itself has written.
_HEADS = (
    b'{"lipservo_export": ', b"Timecode,BlendShapeCount,", b"time_s,sil,", b"0.00\t",
    b'{\n  "metadata": {', b'<?xml version="1.0" encoding="utf-8"?>\n<rhubarbResult>',
)  # fmt: skip


@takes_motion
def export(
    *,
    sound: Annotated[Path, typer.Argument(help="Sound file.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="File to write: .tsv, .json, .xml (Rhubarb), .jsonl or .csv."
        ),
    ],
    file_format: Annotated[
        Format | None,
        typer.Option(
            "--format",
            help="rhubarb: mouth shapes; arkit: 52 blendshapes; ovr: 15 visemes; default: by the "
            "ending of the output file.",
        ),
    ] = None,
    phonemes: Phonemes = None,
    tier: Tier = "",
    alphabet: Alphabet = "",
    text: SpokenText = "",
    channel: Channel = "",
    shapes: Annotated[
        ShapeSource,
        typer.Option(help="Shapes of rhubarb. motion: by the motion; rules: by its own rules."),
    ] = "motion",
    rate_hz: Annotated[
        float, typer.Option(min=10.0, max=200.0, help="Frames per second of arkit and ovr.")
    ] = 60.0,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    motion: ChosenMotion,
    as_json: Json = False,
) -> None:
    """Convert speech to mouth shapes, blendshapes or visemes for an avatar.

    Recognition and motion are those of `lipservo replay`, but larger and with rounder lips
    (`stage: 1`) unless the face's YAML says otherwise. Times count from the first sample of the
    sound.
    """
    from lipservo.commands.run.exported_speech import Exported, exported_text
    from lipsync.output_file import check_output, written_whole

    if text and phonemes is not None:
        raise UserError("give --text or --phonemes, not both")
    chosen = _format(output, file_format)
    if chosen != "rhubarb" and output.suffix.lower() == ".csv" and rate_hz != round(rate_hz):
        raise UserError(f"--rate-hz {rate_hz}: a CSV needs whole frames per second; give 30 or 60")
    check_output(
        output,
        replaces=lambda head: head.startswith(_HEADS),
        kind="export",
        inputs=[sound, phonemes, model],
    )
    request = Exported(
        chosen, output.suffix.lower(), sound, label_file(phonemes, tier, alphabet),
        spoken_text(text), shapes, rate_hz, channel,
    )  # fmt: skip
    lines, about = exported_text(request, motion, config, model)
    with written_whole(output) as partial, partial.open("w", encoding="utf-8") as file:
        file.writelines(lines)
    if as_json:
        print_json({"output": str(output), "format": chosen, **about})
    else:
        MESSAGES.print(f"{output}: done")


def _format(output: Path, given: Format | None) -> Format:
    """Return the format, `given` or by the ending of `output`. Raises UserError if none fits."""
    ending = output.suffix.lower()
    found = given or _FORMAT_OF.get(ending)
    if found is None:
        raise UserError(f"{output}: this file type is unknown; use {', '.join(_FORMAT_OF)}")
    if ending not in _ENDINGS[found]:
        raise UserError(f"{output}: a {found} file must end in {' or '.join(_ENDINGS[found])}")
    return found
