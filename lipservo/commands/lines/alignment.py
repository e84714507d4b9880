"""`lines align`: when each phone of a known text is spoken, and whether it was spoken at all."""

from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Json
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError


def align(
    sound: Annotated[Path, typer.Argument(help="Sound file.")],
    text: Annotated[str, typer.Argument(help="What is said, or a text file that holds it.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write X.TextGrid or X.json."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Find when each phone of a known text is spoken.

    A text that was not said is refused: docs/recognition.md, Alignment, says how that is told.
    """
    if sound.is_dir():
        raise UserError(f"{sound}: is a folder; `lipservo lines align-folder` aligns its texts")
    _align_one(sound, text, output, as_json=as_json)


def _align_one(sound: Path, text: str, output: Path | None, *, as_json: bool) -> None:
    from lipservo.rendering.spoken_line import given_text
    from lipservo.street.phone_file import check_phone_file, write_phone_file
    from lipservo.street.sources import warn
    from lipsync.recognition.alignment.forced_alignment import AlignmentError
    from lipsync.recognition.alignment.forced_alignment import align as force_align
    from lipsync.recognition.alignment.goodness_of_pronunciation import (
        DOUBTFUL_SCORE,
        LEAST_SCORE,
        USUAL_SCORES,
        goodness_of_pronunciation,
    )
    from lipsync.recognition.speech_file import read_speech

    if output is not None:
        check_phone_file(output, inputs=[sound])
    samples = read_speech(sound, warn)
    alignment = force_align(samples, given_text(text))
    score = goodness_of_pronunciation(samples, alignment.phones)
    if score < LEAST_SCORE:
        raise AlignmentError(
            f"{sound}: this text is not what is said there: it scores {score:.2f}, what is said "
            f"scores above {LEAST_SCORE}; check the text"
        )
    if score < DOUBTFUL_SCORE:
        MESSAGES.print(
            f"the text fits badly (score {score:.2f}, usual are {USUAL_SCORES}): words may be "
            "missing or too many, or the voice is hard to hear",
            soft_wrap=True,
        )
    if alignment.guessed:
        MESSAGES.print(f"pronunciation guessed: {', '.join(alignment.guessed)}", soft_wrap=True)
    phones = tuple((e.phoneme, e.start_s, e.end_s or e.start_s) for e in alignment.phones)
    if output is not None:
        write_phone_file(output, {"words": alignment.words, "phones": phones})
    if as_json:
        print_json(
            {
                "phones": phones,
                "words": alignment.words,
                "score": round(score, 3),
                "beams": alignment.beams,
                "guessed": alignment.guessed,
            }
        )
    elif output is None:
        for phoneme, start_s, end_s in phones:
            RESULTS.print(f"{start_s:8.2f} {end_s:8.2f}  {phoneme}")
