"""Reader for corpus folders laid out like `grid_s1`: one speaker, sound, face landmarks, labels."""

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile

from lipservo_lab.corpus.utterance import Corpus, CorpusError, Utterance, Word
from lipsync.array_archive import UNREADABLE, ArrayArchive
from lipsync.arrays import Array
from lipsync.face.head_motion import apply_similarity, fit_similarity, refine_mean
from lipsync.markers import MARKERS_47, PointLayout
from lipsync.phoneme_files.reader import has_phones, read_phonemes
from lipsync.phonemes import PhonemeEvent
from lipsync.textgrid import LabelError, read_tiers

Progress = Callable[[list[str]], Iterable[str]]

#: Landmarks of the outer eye corners, and their distance if it was not measured: it defines the
#: scale.
_RIGHT_EYE, _LEFT_EYE, _EYE_DISTANCE_MM = 33, 263, 90.0
_UNITS_PER_PIXEL = 64.0
#: Pictures have y down and z into them; faces here have y up and z to the viewer.
_TO_FACE_AXES = np.array([1.0, -1.0, -1.0])
#: Picture and sound of one sentence may differ by this much in length (grid_s1: up to 0.03 s).
_LENGTH_TOLERANCE_S = 0.25
#: Largest size of one sentence's points, unpacked: minutes of them.
_MOST_BYTES = 500_000_000


@dataclass(frozen=True, slots=True)
class _Rows:
    """The content of landmarks.json.

    markers, rigid: rows of a frame that are markers of the layout, and points fixed to the skull;
    eyes: places of the eye corners in `rigid`.
    """

    frame_rate_hz: float
    n_landmarks: int
    markers: list[int]
    rigid: list[int]
    eyes: tuple[int, int]
    eye_distance_mm: float


@dataclass(frozen=True, slots=True)
class _Sentence:
    name: str
    landmarks_px: Array
    sound_path: Path
    phones: tuple[PhonemeEvent, ...]
    words: tuple[Word, ...]


def read_grid(
    folder: Path,
    layout: PointLayout = MARKERS_47,
    *,
    head_reference_mm: Array | None = None,
    skip_bad: bool = False,
    progress: Progress = iter,
) -> Corpus:
    """Read all sentences of a folder, head motion removed, in millimetres.

    Parameters
    ----------
    folder : Path
        Laid out like grid_s1.
    layout : PointLayout
        The points of the face to return.
    head_reference_mm : Array | None
        (n_rigid, 3): fit the heads to these points (a model's) rather than to their own mean.
    skip_bad : bool
        Leave out sentences with a missing or mismatched file and list them in `skipped`.
    progress : Progress
        Wraps the names of the sentences, to report how far the work is.

    Returns
    -------
    Corpus
        Markers are (n_frames, n_points, 3) mm.

    Raises
    ------
    CorpusError
        Names the first bad file, unless skip_bad.
    """
    rows = _read_rows(folder, layout)
    sentences: list[_Sentence] = []
    skipped: list[str] = []
    for name in progress(sentence_names(folder)):
        try:
            sentences.append(_read_sentence(folder, name, rows))
        except CorpusError as error:
            if not skip_bad:
                raise CorpusError(f"{error} (--skip-bad goes on without it)") from error
            skipped.append(str(error))
    if not sentences:
        raise CorpusError(
            f"{folder}: no usable sentence; docs/motion.md, A corpus of your own, says what one is"
        )
    rigid = np.concatenate([s.landmarks_px[:, rows.rigid] for s in sentences])
    if head_reference_mm is None:
        head_reference_mm = refine_mean(rigid, (*rows.eyes, rows.eye_distance_mm))
    elif len(head_reference_mm) != rigid.shape[1]:
        raise CorpusError(
            f"{folder / 'landmarks.json'}: {rigid.shape[1]} rigid points, and the model's head has "
            f"{len(head_reference_mm)}; name the same points under groups, rigid, or give a model "
            "learned from such a folder"
        )
    utterances = tuple(_to_utterance(s, rows, head_reference_mm) for s in sentences)
    return Corpus(folder_name(folder), layout, utterances, head_reference_mm, tuple(skipped))


def folder_name(folder: Path) -> str:
    """Return a corpus's name, which is its folder's; also for `.`."""
    return Path(os.path.abspath(folder)).name


def _to_utterance(sentence: _Sentence, rows: _Rows, head_reference_mm: Array) -> Utterance:
    """Return a sentence with its landmarks (px) as markers in mm, head motion removed.

    head_reference_mm: (n_rigid, 3), to which each frame's skull-fixed points are fitted.
    """
    rigid = sentence.landmarks_px[:, rows.rigid]
    similarity = fit_similarity(rigid, head_reference_mm)
    markers_mm = apply_similarity(sentence.landmarks_px[:, rows.markers], *similarity)
    return Utterance(
        sentence.name,
        markers_mm.astype(np.float32),
        rows.frame_rate_hz,
        sentence.sound_path,
        sentence.phones,
        sentence.words,
    )


def _read_rows(folder: Path, layout: PointLayout) -> _Rows:
    """Read landmarks.json: frame rate, and the rows in which the needed landmarks are stored.

    Raises CorpusError, with what is missing.
    """
    path = folder / "landmarks.json"
    try:
        content = json.loads(path.read_text())
        row_of = {number: row for row, number in enumerate(content["landmark_ids"])}
        rigid = content["groups"]["rigid"]
        needed = (*layout.landmarks, *rigid, _RIGHT_EYE, _LEFT_EYE)
        missing = sorted({n for n in needed if n not in row_of})
        if missing:
            some = ", ".join(map(str, missing[:5])) + (", ..." if len(missing) > 5 else "")
            raise CorpusError(
                f"{path}: landmark_ids lacks {some} ({len(missing)} of {len(needed)} points that "
                f"the layout {layout.name} needs); number them as the 478-point face mesh does"
            )
        return _Rows(
            float(content["frame_rate_hz"]),
            len(row_of),
            [row_of[n] for n in layout.landmarks],
            [row_of[n] for n in rigid],
            (rigid.index(_RIGHT_EYE), rigid.index(_LEFT_EYE)),
            float(content.get("eye_distance_mm", _EYE_DISTANCE_MM)),
        )
    except FileNotFoundError:
        raise CorpusError(
            f"{path}: no such file; a corpus folder holds audio/, landmarks/, labels/ and "
            "landmarks.json (docs/motion.md, A corpus of your own)"
        ) from None
    except (KeyError, TypeError, ValueError) as error:
        raise CorpusError(
            f"{path}: not a usable landmark list ({error}); docs/motion.md, A corpus of your own, "
            "says what it holds"
        ) from error


def sentence_names(folder: Path) -> list[str]:
    """Return all names in any of the three folders, sorted, so that missing files are noticed."""
    files = [
        *(folder / "landmarks").glob("*.npz"),
        *(folder / "labels").glob("*.TextGrid"),
        *(folder / "audio").glob("*.flac"),
    ]
    return sorted({path.stem for path in files})


def _read_sentence(folder: Path, name: str, rows: _Rows) -> _Sentence:
    """Read one sentence.

    Raises CorpusError for a missing file, or for sound and pictures whose lengths differ by more
    than `_LENGTH_TOLERANCE_S`. Labels may lack phones.
    """
    landmarks_px = read_landmarks(folder / "landmarks" / f"{name}.npz", rows.n_landmarks)
    sound_path = folder / "audio" / f"{name}.flac"
    duration_s = len(landmarks_px) / rows.frame_rate_hz
    try:
        sound_s = soundfile.info(os.fsencode(sound_path)).duration
    except soundfile.LibsndfileError as error:
        raise CorpusError(f"{sound_path}: missing or not a sound file") from error
    if abs(sound_s - duration_s) > _LENGTH_TOLERANCE_S:
        raise CorpusError(f"{sound_path}: sound {sound_s:.2f} s, landmarks {duration_s:.2f} s")
    _refuse_lost_frames(landmarks_px, folder / "landmarks" / f"{name}.npz")
    label_path = folder / "labels" / f"{name}.TextGrid"
    try:
        tiers = read_tiers(label_path)
        return _Sentence(
            name,
            landmarks_px,
            sound_path,
            read_phonemes(label_path, sound_s) if has_phones(tiers) else (),
            tuple(Word(*interval) for interval in tiers.get("words", ()) if interval[0]),
        )
    except LabelError as error:
        raise CorpusError(str(error)) from error


def read_landmarks(path: Path, n_landmarks: int) -> Array:
    """Read the landmarks of a sentence.

    Parameters
    ----------
    path : Path
        An .npz.
    n_landmarks : int
        Number of landmarks in each frame.

    Returns
    -------
    Array
        (n_frames, n_landmarks, 3) pixels, y up, z to the viewer.

    Raises
    ------
    CorpusError
        The file is missing or damaged.
    """
    try:
        with path.open("rb") as file, ArrayArchive(file, _MOST_BYTES) as archive:
            points = archive["landmarks_64th_px"]
    except FileNotFoundError:
        raise CorpusError(f"{path}: no such file") from None
    except (KeyError, *UNREADABLE) as error:
        raise CorpusError(f"{path}: not a file of landmarks (docs/motion.md)") from error
    if points.ndim != 3 or points.shape[1:] != (n_landmarks, 3) or len(points) < 2:
        raise CorpusError(
            f"{path}: shape {points.shape}; expected (n_frames, {n_landmarks}, 3), n_frames >= 2"
        )
    if not np.isfinite(points).all():
        raise CorpusError(f"{path}: has landmarks that are not numbers; track it again")
    return np.asarray(points / _UNITS_PER_PIXEL * _TO_FACE_AXES, dtype=np.float64)


def _refuse_lost_frames(landmarks_px: Array, path: Path) -> None:
    """Raise CorpusError for a frame whose points are all equal: no face was found in it."""
    lost = np.flatnonzero((landmarks_px == landmarks_px[:, :1]).all(axis=(1, 2)))
    if len(lost):
        raise CorpusError(f"{path}: no face in frame {lost[0]} ({len(lost)} such frames)")
