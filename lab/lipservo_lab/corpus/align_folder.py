"""`lines align-folder`: all transcripts of a folder laid out like LibriSpeech, aligned."""

import os
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, print_json, progress_bar


def align_folder(
    folder: Annotated[
        Path,
        typer.Argument(
            exists=True,
            file_okay=False,
            help="Recordings with texts (docs/recognition.md, Corpora).",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="JSON lines file to write, X.jsonl.")
    ],
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Number of processes; default: one per core.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find when each phone of every transcript of a folder is spoken.

    Texts that are not spoken in their sound are listed: docs/recognition.md, "Alignment".
    """
    from lipservo_lab.corpus.alignment_cache import align_corpus
    from lipservo_lab.corpus.transcribed import read_transcribed
    from lipservo_lab.counted_progress import counting
    from lipsync.recognition.alignment import LEAST_SCORE

    n_processes = jobs or os.cpu_count() or 1
    if output.suffix.lower() != ".jsonl":
        raise typer.BadParameter("name a file for the alignments, X.jsonl", param_hint="--output")
    utterances = read_transcribed(folder)
    with progress_bar(quiet=quiet) as advance:
        count = counting(advance, "aligning", len(utterances))
        aligned = align_corpus(utterances, output, n_processes=n_processes, progress=count)
    failed = {a.name: a.error for a in aligned.values() if a.error}
    unspoken = {
        a.name: a.score for a in aligned.values() if a.score is not None and a.score < LEAST_SCORE
    }
    tight = sum(a.beams == "tight" for a in aligned.values())
    if as_json:
        print_json(
            {"utterances": len(aligned), "tight": tight, "failed": failed, "not_said": unspoken}
        )
        return
    for name, error in failed.items():
        MESSAGES.print(f"not aligned: {name}: {error}", soft_wrap=True)
    for name, score in unspoken.items():
        MESSAGES.print(f"not what is said: {name}: its text scores {score:.2f}", soft_wrap=True)
    good = len(aligned) - len(failed) - len(unspoken)
    RESULTS.print(
        f"{output}: {good} of {len(aligned)} utterances aligned, {tight} of them at the second try",
    )
