"""In which groups the speakers of a corpus are counted.

Which utterances of a corpus a bench is to score, and their alignments.

Recognisers as they are measured: one alone, without the ladder, as a failure must be seen.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from lipservo.settings.motion_names import MeasuredEngine
from lipservo_lab.corpus.alignment_cache import AlignedUtterance, align_corpus
from lipservo_lab.corpus.transcribed import (
    SPEAKERS_FILE,
    TranscribedUtterance,
    of_names,
    of_speakers,
    read_names,
    read_speakers,
    read_transcribed,
)
from lipservo_lab.counted_progress import counting
from lipsync.errors import UserError
from lipsync.phonemes import LiveRecognizer
from lipsync.recognition.energy_recognizer import EnergyRecognizer
from lipsync.recognition.network import DEFAULT_WEIGHTS, find_weights
from lipsync.recognition.network_recognizer import NetworkRecognizer


def selected(
    corpus: Path, speakers: str = "", only: str | None = None, limit: int | None = None
) -> tuple[TranscribedUtterance, ...]:
    """Return the utterances of a folder that pass every filter given.

    speakers: names with commas between; empty: all. only: a file of utterance names. limit: at
    most so many of each speaker. Raises TranscriptError for what is not there.
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
    """Return the alignment of each utterance, by name.

    cache: folder from which alignments are read, and in which new ones are kept; None: no cache.
    n_processes: None: one for each core. advance: called with progress.
    """
    n_processes = n_processes or os.cpu_count() or 1
    count = counting(advance, "aligning", len(utterances))
    return align_corpus(utterances, cache, n_processes=n_processes, progress=count)


def measured_recognizer(
    engine: MeasuredEngine, latency_s: float, weights: str = DEFAULT_WEIGHTS
) -> Callable[[], LiveRecognizer]:
    """Return a function that makes a recogniser of this engine, without a fallback.

    latency_s: of `network`; `energy` has a fixed latency. weights: name or file of the network's.
    Raises WeightsError for unusable weights.
    """
    if engine == "energy":
        return EnergyRecognizer
    network = find_weights(weights)
    return lambda: NetworkRecognizer(network, latency_s)


def known_texts(
    utterances: Sequence[TranscribedUtterance], which: Literal["own", "another"] | None
) -> dict[str, str]:
    """Return the text that the recogniser gets beforehand for each utterance, by name.

    which: "own": the utterance's text; "another": that of the utterance half the list away; None:
    empty texts.
    """
    if which is None:
        return {u.name: "" for u in utterances}
    shift = max(1, len(utterances) // 2) if which == "another" else 0
    texts_from = [*utterances[shift:], *utterances[:shift]]
    return {u.name: source.text.lower() for u, source in zip(utterances, texts_from, strict=True)}


class SpeakerGroupError(UserError):
    """The table does not give a speaker's kind of voice; the message is one line."""


def speaker_groups(
    by: Literal["speaker", "group"] | None, corpus: Path, table: Path | None
) -> Callable[[str], Sequence[str]]:
    """Return a function from a speaker's name to the groups that the speaker counts in.

    by: None: no groups. table: CSV of speakers; None: the one in the corpus's folder. Raises
    SpeakerGroupError if by="group" finds no table, or if a table is given without by="group";
    TranscriptError for a table that cannot be read.
    """
    if by != "group" and table is not None:
        raise SpeakerGroupError(f"--groups {table} is for --by group; give both or neither")
    if by is None:
        return lambda _speaker: ()
    if by == "speaker":
        return lambda speaker: (speaker,)
    path = table or corpus / SPEAKERS_FILE
    if not path.is_file():
        raise SpeakerGroupError(
            f"{path}: no such file; --by group needs a table of speakers, with a first line like "
            "speaker,group,gender (--groups FILE)"
        )
    groups = read_speakers(path)
    return lambda speaker: groups.get(speaker, ("unknown",))
