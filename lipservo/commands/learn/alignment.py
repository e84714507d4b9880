"""`align`: when each phone of a known text is spoken, and whether it was spoken at all."""

import os
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.learn.recognizer import progress_bar
from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, print_json

Jobs = Annotated[
    int | None,
    typer.Option(min=1, help="Processes; default: one a core.", show_default=False),
]


def align(
    sound: Annotated[Path, typer.Argument(help="Sound file, or folder laid out like LibriSpeech.")],
    text: Annotated[
        str | None, typer.Argument(help="What is said, or a text file that holds it.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Write X.TextGrid or X.json; of a folder: X.jsonl, JSON lines."
        ),
    ] = None,
    jobs: Jobs = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find when each phone of a known text is spoken; of a folder, all its transcripts.

    A text that was not said is refused: docs/recognition.md, Alignment, says how that is told.
    """
    if sound.is_dir():
        _align_corpus(sound, output, jobs or os.cpu_count() or 1, as_json=as_json, quiet=quiet)
        return
    if text is None:
        raise typer.BadParameter("say what is said in the sound", param_hint="TEXT")
    _align_one(sound, text, output, as_json=as_json)


def _align_corpus(
    folder: Path, output: Path | None, n_processes: int, *, as_json: bool, quiet: bool
) -> None:
    from lipsync.corpus.transcribed import read_transcribed
    from lipsync.recognition.alignment.alignment_cache import align_corpus
    from lipsync.recognition.alignment.goodness_of_pronunciation import LEAST_SCORE

    if output is None or output.suffix.lower() != ".jsonl":
        raise typer.BadParameter("name a file for the alignments, X.jsonl", param_hint="--output")
    utterances = read_transcribed(folder)
    with progress_bar(quiet=quiet) as advance:
        done: list[str] = []

        def count(name: str) -> None:
            done.append(name)
            advance("aligning", len(done), len(utterances))

        aligned = align_corpus(utterances, output, n_processes=n_processes, progress=count)
    failed = {a.name: a.error for a in aligned.values() if a.error}
    unsaid = {
        a.name: a.score for a in aligned.values() if a.score is not None and a.score < LEAST_SCORE
    }
    tight = sum(a.beams == "tight" for a in aligned.values())
    if as_json:
        print_json(
            {"utterances": len(aligned), "tight": tight, "failed": failed, "not_said": unsaid}
        )
        return
    for name, error in failed.items():
        MESSAGES.print(f"not aligned: {name}: {error}", soft_wrap=True)
    for name, score in unsaid.items():
        MESSAGES.print(f"not what is said: {name}: its text scores {score:.2f}", soft_wrap=True)
    good = len(aligned) - len(failed) - len(unsaid)
    RESULTS.print(
        f"{output}: {good} of {len(aligned)} utterances aligned, {tight} of them at the second try",
        soft_wrap=True,
    )


def _align_one(sound: Path, text: str, output: Path | None, *, as_json: bool) -> None:
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
    alignment = force_align(samples, _text(text))
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


def _text(text: str) -> str:
    """The text itself, or what the file of that name holds."""
    if not _is_file(text):
        return text
    from lipsync.recognition.alignment.forced_alignment import AlignmentError

    try:
        return Path(text).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AlignmentError(f"{text}: cannot be read as text (UTF-8): {error}") from error


def _is_file(text: str) -> bool:
    try:
        return Path(text).is_file()
    except OSError:  # a text too long for a file's name
        return False
