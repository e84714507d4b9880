"""The command `lines render`, which renders a sound to a performance file."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from lipservo.commands.options import Alphabet, Channel, Json, Model, Tier, label_file
from lipservo.settings.motion_names import STRONGEST
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError

Method = Literal["heard", "model-based", "live"]

# ---- options of all that renders lines ----

LineMethodName = Annotated[
    Method,
    typer.Option(
        help="heard: by phonemes and the sound; model-based: as published by Edge, Hilton and "
        "Jackson; live: as a running face moves."
    ),
]
LineStrength = Annotated[
    float, typer.Option(min=0.0, max=STRONGEST, help="Amplitude of the motion; 1: as recorded.")
]
Offline = Annotated[
    Path | None,
    typer.Option(
        help="Model file of `learn offline` for methods heard and model-based; default: shipped."
    ),
]
ReferenceSound = Annotated[
    bool, typer.Option("--reference-sound", help="Store the sound file's name only, not its sound.")
]
ExpressionOf = Annotated[
    str | None,
    typer.Option(
        metavar="FACE",
        help="Also store head, eyes, lids and brows, as this face (a name, or a YAML file) moves "
        "them.",
    ),
]


def render(
    audio: Annotated[Path, typer.Argument(help="Sound file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Performance (.perf) to write.")],
    text: Annotated[
        str | None, typer.Option(help="Text spoken in the sound file, or a text file with it.")
    ] = None,
    textgrid: Annotated[
        Path | None,
        typer.Option(
            help="Label file: phonemes or words with times, a TextGrid or others (docs/text.md)."
        ),
    ] = None,
    tier: Tier = "",
    alphabet: Alphabet = "",
    channel: Channel = "",
    method: LineMethodName = "heard",
    strength: LineStrength = 1.0,
    model: Model = None,
    offline: Offline = None,
    reference_sound: ReferenceSound = False,
    expression: ExpressionOf = None,
    as_json: Json = False,
) -> None:
    """Render a sound file to a performance: motion planned with the whole line known.

    Without --text and --textgrid the recogniser finds the phonemes. For a folder of sounds: `lines
    render-folder`.
    """
    from lipservo.rendering.rendered import Rendering
    from lipservo.runtime.servos.assembly import load_settings
    from lipsync.audio.file import open_sound
    from lipsync.errors import check_extra, check_inputs

    if text is not None and textgrid is not None:
        raise UserError("give --text or --textgrid, not both")
    how = Rendering(method, strength, model, offline, not reference_sound, expression)
    if expression is not None:
        load_settings(expression)  # refused before anything is heard
    if audio.is_dir():
        raise UserError(f"{audio}: is a folder; `lipservo lines render-folder` renders its sounds")
    open_sound(audio).close()
    check_inputs(textgrid, model, offline)
    if method == "model-based":
        check_extra("dtaidistance", "render --method model-based")
    labels = label_file(textgrid, tier, alphabet)
    from lipservo.rendering.rendered import render as render_line
    from lipservo.rendering.spoken_line import Script, given_text
    from lipsync.offline.performance import is_performance
    from lipsync.output_file import check_output

    script = Script(labels, None if text is None else given_text(text), channel)
    inputs = [audio, None if labels is None else labels.path, model, offline]
    check_output(output, replaces=is_performance, kind="performance", inputs=inputs)
    done = render_line(audio, script, output, how)
    for note in done.notes:
        MESSAGES.print(f"{audio}: {note}")
    if as_json:
        print_json(
            {
                "output": str(output),
                "method": how.method,
                "duration_s": done.duration_s,
                "phonemes": done.n_phonemes,
                "seconds": round(done.seconds, 3),
                "notes": done.notes,
            }
        )
        return
    RESULTS.print(
        f"{output}: {done.duration_s:.1f} s, {done.n_phonemes} phonemes, {how.method}, rendered in "
        f"{done.seconds:.2f} s",
    )
