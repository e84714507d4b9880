"""The command `film`, which writes a film, with sound, of a face that speaks."""

from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import (
    DEFAULT_FACE,
    Alphabet,
    Channel,
    Config,
    Json,
    Landmarker,
    Model,
    Phonemes,
    Quiet,
    SpokenText,
    Tier,
    label_file,
)
from lipservo.commands.run.motion_choice import takes_motion
from lipservo.commands.run.voice_choice import spoken_text
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.terminal.output import MESSAGES, print_json, progress_bar
from lipsync.errors import UserError, check_inputs

#: What is no name of a photograph.
_TWIN, _ROBOT, _BESIDE = "twin", "robot", "beside"


@takes_motion
def film(
    *,
    speech: Annotated[
        str | None, typer.Argument(help="Sound file, text in quotes, or performance file (.perf).")
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Film to write: .mp4 .mov .mkv.")],
    face: Annotated[
        str,
        typer.Option(
            help="twin: a drawn face; robot: the robot, drawn; beside: both; or a photograph of a "
            "face (JPEG, PNG ...)."
        ),
    ] = _TWIN,
    landmarks: Annotated[
        Path | None,
        typer.Option(
            help="JSON file of the face's points in the photograph, instead of a tracker "
            "(docs/film.md)."
        ),
    ] = None,
    landmarker: Landmarker = None,
    beside: Annotated[
        str | None,
        typer.Option(
            metavar="STRATEGY|PERF",
            help="Show a second face at the right, moved by this strategy or performance.",
        ),
    ] = None,
    trace: Annotated[
        Path | None,
        typer.Option(
            help="Film the run recorded in this trace; SPEECH is then its sound file, if any."
        ),
    ] = None,
    phonemes: Phonemes = None,
    tier: Tier = "",
    alphabet: Alphabet = "",
    text: SpokenText = "",
    channel: Channel = "",
    still_head: Annotated[
        bool, typer.Option("--still-head", help="Head, eyes and lids do not move.")
    ] = False,
    size: Annotated[
        str, typer.Option(metavar="WIDTHxHEIGHT", help="Size of one face, WIDTHxHEIGHT pixels.")
    ] = "640x480",
    rate_hz: Annotated[int, typer.Option(min=10, max=60, help="Pictures per second.")] = 25,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    motion: ChosenMotion,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Film a face that speaks a sound file, a text or a performance, or one in a recorded run.

    The film has the sound. It is made faster than real time; no incomplete file is left.
    """
    from lipservo.display.film import check_film, is_file, is_film, named_file
    from lipsync.output_file import check_output

    if speech is None and trace is None:
        raise typer.BadParameter("give a sound, a text or a performance, or --trace FILE")
    if trace is not None and beside is not None:
        raise typer.BadParameter("give --trace or --beside, not both")
    if landmarks is not None and face in (_TWIN, _ROBOT, _BESIDE):
        raise UserError(f"--landmarks: {face} does not use them; give a photograph as --face")
    inputs = [Path(face), Path(speech or ""), trace, phonemes, model, landmarks]
    check_inputs(trace, phonemes, model, landmarks, named_file(speech or ""))
    check_film(output)
    from lipservo.display.filmed_faces import FilmRequest, make_film

    check_output(
        output, replaces=is_film, kind="film", inputs=[each for each in inputs if is_file(each)]
    )
    request = FilmRequest(
        speech, output, face, _size(size), rate_hz, config, model,
        landmarks=landmarks, landmarker=landmarker, beside=beside, trace=trace,
        script=label_file(phonemes, tier, alphabet), text=spoken_text(text), still_head=still_head,
        channel=channel,
    )  # fmt: skip
    with progress_bar(quiet=quiet or as_json) as advance:
        done = make_film(request, motion, advance)
    if as_json:
        print_json({"output": str(output), **done})
    else:
        MESSAGES.print(f"{output}: {done['duration_s']:.1f} s, filmed in {done['seconds']:.1f} s")


def _size(text: str) -> tuple[int, int]:
    """Parse `WIDTHxHEIGHT`, even numbers of pixels from 128 to 1920, or raise BadParameter."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise typer.BadParameter(f"--size {text}: write WIDTHxHEIGHT, for example 640x480")
    found = int(width), int(height)
    if min(found) < 128 or max(found) > 1920 or any(each % 2 for each in found):
        raise typer.BadParameter(f"--size {text}: sides must be even, 128 to 1920 pixels")
    return found
