"""Which utterances of a corpus a bench was asked for, and their alignments."""

import os
from collections.abc import Callable
from pathlib import Path

from lipservo_lab.corpus.alignment_cache import AlignedUtterance, align_corpus
from lipservo_lab.corpus.transcribed import (
    TranscribedUtterance,
    of_names,
    of_speakers,
    read_names,
    read_transcribed,
)


def selected(
    corpus: Path, speakers: str = "", only: str | None = None, limit: int | None = None
) -> tuple[TranscribedUtterance, ...]:
    """Utterances of a folder: of some speakers, of a list of names, the first of each speaker.

    speakers: with commas between, none for all. Raises TranscriptError for what is not there.
    """
    everything = read_transcribed(corpus)
    if only is not None:
        everything = of_names(everything, read_names(only))
    chosen = frozenset(name.strip() for name in speakers.split(",") if name.strip())
    return of_speakers(everything, chosen, limit)


def aligned(
    utterances: tuple[TranscribedUtterance, ...],
    cache: Path | None,
    n_processes: int | None,
    advance: Callable[[str, int, int], None],
) -> dict[str, AlignedUtterance]:
    """Their alignments by name: from the cache, or made now and kept there."""
    names: list[str] = []

    def count(name: str) -> None:
        names.append(name)
        advance("aligning", len(names), len(utterances))

    n_processes = n_processes or os.cpu_count() or 1
    return align_corpus(utterances, cache, n_processes=n_processes, progress=count)
