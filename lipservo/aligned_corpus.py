"""Which utterances of a corpus a bench was asked for, and their alignments."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from lipsync.corpus.transcribed import (
    TranscribedUtterance,
    of_names,
    of_speakers,
    read_names,
    read_transcribed,
)
from lipsync.recognition.alignment_cache import AlignedUtterance, align_corpus


@dataclass(frozen=True, slots=True)
class Selection:
    """Utterances of a folder: of some speakers, of a list of names, the first of each speaker."""

    corpus: Path
    speakers: str = ""
    only: str | None = None
    limit: int | None = None

    def utterances(self) -> tuple[TranscribedUtterance, ...]:
        """What was selected; TranscriptError for speakers and names that are not there."""
        everything = read_transcribed(self.corpus)
        if self.only is not None:
            everything = of_names(everything, read_names(self.only))
        chosen = frozenset(name.strip() for name in self.speakers.split(",") if name.strip())
        return of_speakers(everything, chosen, self.limit)


def aligned(
    selection: Selection,
    cache: Path | None,
    n_processes: int | None,
    advance: Callable[[str, int, int], None],
) -> tuple[tuple[TranscribedUtterance, ...], dict[str, AlignedUtterance]]:
    """The utterances, and their alignments by name: from the cache, or made now and kept there."""
    utterances = selection.utterances()
    names: list[str] = []

    def count(name: str) -> None:
        names.append(name)
        advance("aligning", len(names), len(utterances))

    n_processes = n_processes or os.cpu_count() or 1
    return utterances, align_corpus(utterances, cache, n_processes=n_processes, progress=count)
