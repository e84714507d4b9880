"""The soft expectation: the mouth's mean motion, predicted from the recogniser's probabilities.

A decoder decides for one phoneme at each instant and discards how sure it was; what it discards is
missed in the motion. Here the posteriors, the recogniser's probabilities of all phonemes, of the
frames around an instant, written as features of phonemes (articulation and viseme class, so that
unknown words are made of known parts), become a face: by a ridge over random cosines (Rahimi and
Recht, "Random features for large-scale kernel machines", NIPS 2007) and a small network of
rectifiers, averaged. The face has its share in the motion where the recogniser doubts, and none
where it is sure: phonemes known from a text or a file are as sharp as posteriors can be, and move
the mouth as they are decided.

Inference only, NumPy only, bounded. Its arrays are an optional part of a model file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Array32
from lipsync.expectation.expectation import PhonemeTrack, track_of
from lipsync.face.model import ModelFile
from lipsync.phonemes import PHONEMES, FramePosteriors, PhonemeEvent

#: Of the posteriors that it was learned from.
FRAMES_PER_S: Final = 100
#: First and last frame of each mean that is taken, from an instant. Further back a window tells
#: words apart by heart, and those never met are read worse (docs/decisions/motion.md).
WINDOWS: Final = (
    (-15, -11), (-10, -8), (-7, -5), (-4, -2), (-1, 1), (2, 4), (5, 7), (8, 10), (11, 15),
)  # fmt: skip
#: Frames that a window reaches, from an instant.
OFFSETS: Final = np.arange(WINDOWS[0][0], WINDOWS[-1][1] + 1)
_FIRST_OF = np.array([first - WINDOWS[0][0] for first, _ in WINDOWS])
_LENGTHS = np.array([last - first + 1 for first, last in WINDOWS], np.float32)[:, None]
#: How sure a recogniser is: its largest posterior, on average over so many frames before and after.
_DOUBT_FRAMES = 10
_NEAR = slice(-WINDOWS[0][0] - _DOUBT_FRAMES, -WINDOWS[0][0] + _DOUBT_FRAMES + 1)
#: Share of the soft face for each unit of doubt, and the most of it; chosen on inner splits.
SHARE_PER_DOUBT, LARGEST_SHARE = 3.0, 0.6
#: Frames remembered: more than any window and look-ahead reach.
_KEPT = 256
#: Posteriors that sum to something else are none.
_SUM_TOLERANCE = 0.05
#: Sums of the same times differ by less.
_ROUNDING_S = 1e-6


class BelievedFrames:
    """A buffer of posteriors, the recogniser's probabilities of phonemes, of the last 256 frames.

    The recogniser has several heads. A head with a longer delay estimates a frame later, and its
    posteriors replace the earlier ones.
    """

    def __init__(self) -> None:
        self._rows = np.zeros((_KEPT, len(PHONEMES)), np.float32)
        self._frames = np.full(_KEPT, -1)

    def push(self, posteriors: FramePosteriors) -> bool:
        """Store new posteriors; return whether all are valid and of our inventory and frame rate.

        Of another inventory or rate nothing is stored. Invalid rows (not summing to 1, or negative)
        and frames before 0 are left out.
        """
        values = posteriors.values[-_KEPT:]
        has_all_phonemes = values.shape[1:] == (len(posteriors.delays), len(PHONEMES))
        if not has_all_phonemes or posteriors.frames_per_s != FRAMES_PER_S:
            return False
        first = posteriors.first_frame + len(posteriors.values) - len(values)
        sums = values.sum(axis=2)
        # Also false for NaN.
        usable = (np.abs(sums - 1.0) <= _SUM_TOLERANCE) & (values.min(axis=2) >= 0.0)
        for head, delay in enumerate(posteriors.delays):
            frames = np.arange(first - delay, first - delay + len(values))
            is_stored = usable[:, head] & (frames >= 0)
            places = frames[is_stored] % _KEPT
            self._rows[places] = values[is_stored, head]
            self._frames[places] = frames[is_stored]
        return bool(usable.all())

    def around(self, track: PhonemeTrack, times_s: Array, known_until_s: float) -> Array32:
        """Return the posteriors of the frames from 0.15 s before to 0.15 s after each time.

        Frames without posteriors get 1 for the decided phoneme and 0 for all others; beyond
        `known_until_s` they get 0 for all.

        Parameters
        ----------
        track : PhonemeTrack
            Decided phonemes.
        times_s : Array
            (n,) sound times.
        known_until_s : float
            Sound time until which decided phonemes are known.

        Returns
        -------
        Array32
            (n, n_frames, n_phonemes), 0 to 1.
        """
        # The buffer is a ring: frame f lies at f modulo 256, if it has not been replaced since.
        frames = np.rint(times_s * FRAMES_PER_S).astype(np.int64)[:, None] + OFFSETS
        places = frames % _KEPT
        rows: Array32 = self._rows[places]
        missing = self._frames[places] != frames
        if missing.any():
            # Elsewhere the decided phoneme, as if the recogniser were sure of it.
            middles_s = (frames[missing] + 0.5) / FRAMES_PER_S
            index = np.searchsorted(np.array(track.starts_s), middles_s, side="right") - 1
            sharp = _SHARP[np.array(track.phonemes)[index]]
            sharp[middles_s > known_until_s + _ROUNDING_S] = 0.0
            rows[missing] = sharp
        return rows


_SHARP = np.eye(len(PHONEMES), dtype=np.float32)


def window_means(rows: Array32) -> Array32:
    """Return the mean over the frames of each of the nine `WINDOWS`.

    Parameters
    ----------
    rows : Array32
        (n, n_frames, k) values of the frames.

    Returns
    -------
    Array32
        (n, n_windows, k) means.
    """
    # The windows lie end to end, so the sums of all are taken between their first frames.
    sums = np.add.reduceat(rows, _FIRST_OF, axis=1)
    return np.asarray(sums / _LENGTHS, np.float32)


def shares_of(rows: Array32) -> Array:
    """Return the soft expectation's share of the motion, which grows with the recogniser's doubt.

    The doubt is 1 minus the largest posterior, averaged over the known frames within 0.1 s.

    Parameters
    ----------
    rows : Array32
        (n, n_frames, n_phonemes) posteriors around each time; all 0 in frames not known.

    Returns
    -------
    Array
        (n,), 0 to `LARGEST_SHARE`, 0.6.
    """
    surest = rows[:, _NEAR].max(axis=2)
    n_known = np.maximum((surest > 0.0).sum(axis=1), 1)
    doubt = 1.0 - surest.sum(axis=1) / n_known
    return np.asarray(np.clip(SHARE_PER_DOUBT * doubt, 0.0, LARGEST_SHARE), np.float64)


@dataclass(frozen=True, slots=True)
class SoftExpectation:
    """The learned map from mean posteriors around an instant to a face; d = n_windows k inputs.

    looks: (n_phonemes, k), features of each phoneme. frequencies (d, n_cosines) and phases of the
    cosines; first (d + 1, h1) and second (h1 + 1, h2), layers of rectifiers with their biases last.
    output: (n_cosines + d + h2 + 1, n_components), for cosines, inputs, rectifiers and 1.
    """

    looks: Array32
    frequencies: Array32
    phases: Array32
    first: Array32
    second: Array32
    output: Array32

    def faces(self, means: Array32) -> Array:
        """Return the faces expected by mean posteriors.

        Parameters
        ----------
        means : Array32
            (n, n_windows, n_phonemes) mean posteriors, of `window_means`.

        Returns
        -------
        Array
            (n, n_components) face coefficients.
        """
        return np.asarray(self.hidden(means) @ self.output, np.float64)

    def hidden(self, means: Array32) -> Array32:
        """Return the values (cosines, inputs, rectifiers, 1) whose weighted sum is a face.

        Parameters
        ----------
        means : Array32
            (n, n_windows, n_phonemes) mean posteriors.

        Returns
        -------
        Array32
            (n, n_cosines + d + h2 + 1) values.
        """
        inputs = (means @ self.looks).reshape(len(means), -1)
        cosines = np.cos(inputs @ self.frequencies + self.phases)
        layer1 = np.maximum(inputs @ self.first[:-1] + self.first[-1], 0.0)
        layer2 = np.maximum(layer1 @ self.second[:-1] + self.second[-1], 0.0)
        ones = np.ones((len(means), 1), np.float32)
        return np.concatenate([cosines, inputs, layer2, ones], axis=1)

    def mixed(
        self,
        faces: Array,
        believed: BelievedFrames,
        track: PhonemeTrack,
        times_s: Array,
        known_until_s: float,
    ) -> Array:
        """Return faces expected from decided phonemes, with a share of those from posteriors.

        Parameters
        ----------
        faces : Array
            (n, n_components), by decided phonemes.
        believed : BelievedFrames
            Posteriors so far.
        track : PhonemeTrack
            Decided phonemes.
        times_s : Array
            (n,) sound times of the faces.
        known_until_s : float
            Sound time until which decided phonemes are known.

        Returns
        -------
        Array
            (n, n_components) mixed faces; `faces` itself where no posterior is in doubt.
        """
        rows = believed.around(track, times_s, known_until_s)
        shares = shares_of(rows)
        if not shares.any():
            return faces
        return faces + shares[:, None] * (self.faces(window_means(rows)) - faces)

    def check(self, n_components: int) -> None:
        """Raise ValueError unless shapes fit each other and `n_components`, and all is finite."""
        d = len(WINDOWS) * self.looks.shape[1]
        n_cosines, h1, h2 = len(self.phases), self.first.shape[1], self.second.shape[1]
        shapes = {
            "looks": (len(PHONEMES), self.looks.shape[1]),
            "frequencies": (d, n_cosines),
            "phases": (n_cosines,),
            "first": (d + 1, h1),
            "second": (h1 + 1, h2),
            "output": (n_cosines + d + h2 + 1, n_components),
        }
        for name, expected in shapes.items():
            values: Array32 = getattr(self, name)
            if values.shape != expected:
                raise ValueError(f"array soft/{name} has shape {values.shape}, not {expected}")
            if not np.isfinite(values).all():
                raise ValueError(f"array soft/{name} of the file has values that are not finite")


#: A line is gone through in stretches that are remembered with all that their windows reach.
_STRETCH_FRAMES = 128


def softened_line(
    soft: SoftExpectation,
    faces: Array,
    events: Sequence[PhonemeEvent],
    posteriors: FramePosteriors,
    times_s: Array,
) -> Array:
    """Return a whole recording's faces, with the share of those expected from its posteriors.

    Parameters
    ----------
    soft : SoftExpectation
        The map from posteriors to faces.
    faces : Array
        (n, n_components), expected from decided phonemes.
    events : Sequence[PhonemeEvent]
        Decided phonemes.
    posteriors : FramePosteriors
        The recogniser's probabilities of phonemes for the whole recording.
    times_s : Array
        (n,) sound times of the faces.

    Returns
    -------
    Array
        (n, n_components) mixed faces.
    """
    believed, track = BelievedFrames(), track_of(events)
    mixed, n_pushed = faces.copy(), 0
    # Stretch by stretch, as only 256 frames are remembered: first all posteriors that its faces
    # need, up to those of the head with the longest delay, then the faces.
    stretches = (times_s * FRAMES_PER_S / _STRETCH_FRAMES).astype(np.int64)
    for stretch in np.unique(stretches).tolist():
        inside = stretches == stretch
        end_frame = (stretch + 1) * _STRETCH_FRAMES + int(OFFSETS[-1]) + max(posteriors.delays) + 1
        newest = replace(
            posteriors,
            first_frame=posteriors.first_frame + n_pushed,
            values=posteriors.values[n_pushed:end_frame],
        )
        believed.push(newest)
        n_pushed += len(newest.values)
        mixed[inside] = soft.mixed(faces[inside], believed, track, times_s[inside], np.inf)
    return mixed


#: The part of a model file that holds the soft expectation.
SOFT_PART: Final = "soft"
_NAMES = tuple(field.name for field in fields(SoftExpectation))


def read_soft_expectation(file: ModelFile, n_components: int) -> SoftExpectation | None:
    """Return a model file's map from posteriors to faces; None if it has none. Raises ModelError.

    n_components: number of components of the face that the expectation moves.
    """
    if not file.has(SOFT_PART):
        return None

    def assemble(arrays: Mapping[str, NDArray[np.generic]]) -> SoftExpectation:
        soft = SoftExpectation(*(np.asarray(arrays[name], np.float32) for name in _NAMES))
        soft.check(n_components)
        return soft

    return file.read(SOFT_PART, assemble)


def soft_arrays(soft: SoftExpectation) -> dict[str, NDArray[np.generic]]:
    """Return the arrays to store in a model file: float16, as its rounding moves no lip by 0.01 mm.

    Parameters
    ----------
    soft : SoftExpectation
        The expectation to store.

    Returns
    -------
    dict[str, NDArray[np.generic]]
        By name, each in its field's shape.
    """
    return {name: getattr(soft, name).astype(np.float16) for name in _NAMES}
