"""Alignments of a whole corpus: made in parallel, stored as JSON lines; interrupted runs go on.

One line an utterance: name, text, beams, phones [name, first frame, frame after the last], guessed
words, and the score of the text (goodness_of_pronunciation); or, for one that could not be aligned,
name, text and error. Failures are stored too, so that they are counted and not tried again. Where a
corpus has its own labels of the phones, these are used, and `beams` says so.

While alignments are missing, those done are in NAME.unfinished, from which an interrupted run goes
on; the file itself is written when all are done.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipservo_lab.worker_pool import worker_pool
from lipsync.errors import UserError
from lipsync.output_file import check_output, write_whole
from lipsync.phoneme_files.reader import read_phonemes
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent
from lipsync.recognition.alignment import align, check_aligner, goodness_of_pronunciation
from lipsync.recognition.features import FRAMES_PER_S

#: Value of `beams` for phones from the corpus's own label files.
LABELLED = "labelled"

PHONEME_INDEX: Mapping[str, int] = {phoneme: index for index, phoneme in enumerate(PHONEMES)}


class CacheError(UserError):
    """An alignment file cannot be used; the message is one line."""


@dataclass(frozen=True, slots=True)
class AlignedUtterance:
    """The alignment of one utterance; `phones` is empty when `error` says why.

    beams: settings of the aligner that succeeded, "default" or "tight", or `LABELLED`. phones:
    (phoneme, first frame, frame after the last) at 100 frames a second. guessed: words whose
    pronunciation was guessed. score: of the text; None for a corpus's own labels and files of older
    versions.
    """

    name: str
    text: str
    beams: str = ""
    phones: tuple[tuple[str, int, int], ...] = ()
    guessed: tuple[str, ...] = ()
    error: str = ""
    score: float | None = None

    def labels(self, n_frames: int) -> NDArray[np.int64]:
        """Return the phoneme's index in `PHONEMES` for each frame of 10 ms; silence after the end.

        Parameters
        ----------
        n_frames : int
            Number of frames.

        Returns
        -------
        NDArray[np.int64]
            (n_frames,).
        """
        labels = np.full(n_frames, PHONEME_INDEX[SILENCE])
        for phoneme, first, end in self.phones:
            labels[first:end] = PHONEME_INDEX[phoneme]
        return labels

    def events(self) -> tuple[PhonemeEvent, ...]:
        """Return the phones with their times."""
        return tuple(
            PhonemeEvent(phoneme, first / FRAMES_PER_S, end / FRAMES_PER_S)
            for phoneme, first, end in self.phones
        )

    def as_line(self) -> str:
        """Return the utterance as a line of the file."""
        record: dict[str, object] = {"name": self.name, "text": self.text}
        if self.error:
            record["error"] = self.error
        else:
            record |= {"beams": self.beams, "phones": self.phones, "guessed": self.guessed}
            record |= {} if self.score is None else {"score": self.score}
        return json.dumps(record) + "\n"


def read_alignments(path: Path) -> dict[str, AlignedUtterance]:
    """Read an alignment file; return utterances by name. Raises CacheError for a damaged file.

    A last line without its end, left by a run that was killed, is skipped.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise CacheError(f"{path}: is not a file of alignments; choose another name") from error
    complete = text[: text.rfind("\n") + 1]
    found: dict[str, AlignedUtterance] = {}
    for number, line in enumerate(complete.splitlines(), start=1):
        try:
            record = json.loads(line)
            found[record["name"]] = AlignedUtterance(
                record["name"],
                record["text"],
                record.get("beams", ""),
                tuple((str(p), int(first), int(end)) for p, first, end in record.get("phones", ())),
                tuple(record.get("guessed", ())),
                record.get("error", ""),
                None if record.get("score") is None else float(record["score"]),
            )
        except (ValueError, LookupError, TypeError) as error:
            raise CacheError(
                f"{path}, line {number}: no alignment ({error}); delete the file to start afresh"
            ) from error
    return found


def align_corpus(
    utterances: tuple[TranscribedUtterance, ...],
    path: Path | None,
    *,
    n_processes: int = 1,
    progress: Callable[[str], None] = lambda _name: None,
) -> dict[str, AlignedUtterance]:
    """Return the alignment of every utterance by name, also failed ones.

    Utterances in the file at `path`, or in its unfinished twin, with the same text are not aligned
    again; new alignments are added. path: None stores nothing. progress: called with each name
    once. Raises CacheError for a file that cannot be used, OutputError for one that cannot be
    written, MissingExtraError without the extra `align`.
    """
    stored = _known(path)
    aligned_by_name: dict[str, AlignedUtterance] = {}
    for utterance in utterances:
        stored_one = stored.get(utterance.name)
        if stored_one is not None and stored_one.text == utterance.text:
            aligned_by_name[utterance.name] = stored_one
            progress(utterance.name)
    missing = [utterance for utterance in utterances if utterance.name not in aligned_by_name]
    if not missing:
        return {utterance.name: aligned_by_name[utterance.name] for utterance in utterances}
    if any(utterance.labels is None for utterance in missing):
        check_aligner()
    with ExitStack() as stack:
        file = None
        if path is not None:
            check_output(path, replaces=is_alignments, kind="file of alignments")
            unfinished = unfinished_of(path)
            _drop_torn_line(unfinished)
            file = stack.enter_context(unfinished.open("a", encoding="utf-8"))
        for aligned in _align_all(missing, n_processes):
            if file is not None:
                file.write(aligned.as_line())
                file.flush()
            aligned_by_name[aligned.name] = aligned
            progress(aligned.name)
    if path is not None:
        # Alignments of other folders in the same file stay in it.
        lines = "".join(alignment.as_line() for alignment in (stored | aligned_by_name).values())
        write_whole(path, lines)
        unfinished_of(path).unlink()
    return {utterance.name: aligned_by_name[utterance.name] for utterance in utterances}


def unfinished_of(path: Path) -> Path:
    """Return the file that holds alignments while some are missing."""
    return path.with_name(path.name + ".unfinished")


def is_alignments(head: bytes) -> bool:
    """Return whether a file that begins with `head` is a file of alignments."""
    return head.startswith(b'{"name": ')


def _known(path: Path | None) -> dict[str, AlignedUtterance]:
    """Return the alignments in the file and its unfinished twin, by name."""
    if path is None:
        return {}
    known = read_alignments(path) if path.exists() else {}
    unfinished = unfinished_of(path)
    return known | (read_alignments(unfinished) if unfinished.exists() else {})


def align_utterance(utterance: TranscribedUtterance) -> AlignedUtterance:
    """Read and align one utterance; a file or text that cannot be used becomes its `error`."""
    from lipsync.audio.file import read_speech

    if utterance.labels is not None:
        return _labelled(utterance, utterance.labels)
    try:
        samples = read_speech(utterance.sound)
        alignment = align(samples, utterance.text)
    except UserError as error:
        return AlignedUtterance(utterance.name, utterance.text, error=str(error))
    return AlignedUtterance(
        utterance.name,
        utterance.text,
        alignment.beams,
        _in_frames(alignment.phones),
        alignment.guessed,
        score=round(goodness_of_pronunciation(samples, alignment.phones), 3),
    )


def _labelled(utterance: TranscribedUtterance, labels: Path) -> AlignedUtterance:
    """Return an utterance with the phones of its own label file, or the error of reading it."""
    try:
        phones = _in_frames(read_phonemes(labels))
    except UserError as error:
        return AlignedUtterance(utterance.name, utterance.text, error=str(error))
    return AlignedUtterance(utterance.name, utterance.text, LABELLED, phones)


def _in_frames(events: Iterable[PhonemeEvent]) -> tuple[tuple[str, int, int], ...]:
    """Return (phoneme, first frame, frame after the last) of events with an end."""
    return tuple(
        (event.phoneme, round(event.start_s * FRAMES_PER_S), round(event.end_s * FRAMES_PER_S))
        for event in events
        if event.end_s is not None
    )


def _align_all(missing: list[TranscribedUtterance], n_processes: int) -> Iterator[AlignedUtterance]:
    """Yield the alignments of utterances as they are made, in parallel if `n_processes` > 1."""
    if n_processes <= 1 or len(missing) <= 1:
        yield from map(align_utterance, missing)
        return
    with worker_pool(n_processes) as pool:
        yield from pool.map(align_utterance, missing, chunksize=4)


def _drop_torn_line(path: Path) -> None:
    """Remove an incomplete last line from a file, if the file exists."""
    if not path.exists():
        return
    text = path.read_bytes()
    path.write_bytes(text[: text.rfind(b"\n") + 1])
