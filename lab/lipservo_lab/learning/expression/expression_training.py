"""A folder of tracks becomes a model and its figures on what was held out.

How head motion goes with a voice: canonical correlation, lag, power spectra. Offline.

Prosody is (n, 2), pitch and loudness z at 25 Hz; poses are (n, 3) degrees. Each list holds one
array a recording; nothing is computed across their ends.

How a learned expression moves on recordings that it has not learned from.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from lipservo_lab.learning.expression.expression_fit import blink_times_s, fit_expression, smoothed
from lipservo_lab.learning.expression.grid_tracks import read_grid_tracks
from lipservo_lab.learning.expression.tracks import (
    HEAD,
    LIDS,
    ExpressionTrack,
    HeardTrack,
    Progress,
    TrackError,
    check_alike,
    hear,
    no_progress,
    read_track_files,
)
from lipservo_lab.learning.learned_expression.expression_model import RATE_HZ, ExpressionModel
from lipservo_lab.learning.learned_expression.learned_expression import (
    SILENT_Z,
    BlinkTiming,
    LearnedExpression,
)
from lipsync.arrays import Array
from lipsync.expression.cue import ExpressionCue
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame

#: What was heard now and until 160 ms ago: heads follow a voice by 30 ms on average (Fotedar and
#: Ghosh 2017).
_N_LAGS = 5
_MOST_LAG_FRAMES = 10
_LEAST_LAG_FRAMES = -5
#: 1.28 s; clips are 3 s long.
_PSD_FRAMES = 32
_LEAST_POWER = 1e-9


def canonical_correlation(x: Array, y: Array) -> float:
    """Return the greatest correlation of any mixture of x with any of y; Hotelling 1936.

    Parameters
    ----------
    x : Array
        (n, p).
    y : Array
        (n, q).

    Returns
    -------
    float
        0 to 1.
    """

    def orthonormal(values: Array) -> Array:
        centred = values - values.mean(axis=0)
        u, s, _ = np.linalg.svd(centred, full_matrices=False)
        kept: Array = u[:, s > 1e-9 * max(1.0, float(s[0]))]
        return kept

    products = orthonormal(x).T @ orthonormal(y)
    return float(np.linalg.svd(products, compute_uv=False)[0]) if products.size else 0.0


def head_correlation(prosody: Sequence[Array], poses: Sequence[Array]) -> float:
    """Return the first canonical correlation of the last 200 ms of voice with the head's motion.

    Motion: speed, velocity of pitch and its amount.

    Parameters
    ----------
    prosody : Sequence[Array]
        (n, 2) each.
    poses : Sequence[Array]
        (n, 3) each.

    Returns
    -------
    float
        0 to 1.
    """
    x, y = [], []
    for heard, pose in zip(prosody, poses, strict=True):
        x.append(np.concatenate([heard[_N_LAGS - k : len(heard) - k] for k in range(_N_LAGS)], 1))
        y.append(_motion(pose)[_N_LAGS - 1 :])
    return canonical_correlation(np.concatenate(x), np.concatenate(y))


def head_lag_s(prosody: Sequence[Array], poses: Sequence[Array]) -> tuple[float, float]:
    """Return by how much the head's speed follows loudness, and their correlation there.

    Parameters
    ----------
    prosody : Sequence[Array]
        (n, 2) each.
    poses : Sequence[Array]
        (n, 3) each.

    Returns
    -------
    tuple[float, float]
        -0.2 to 0.4 s, and the correlation.
    """
    best = (0.0, 0.0)
    for lag in range(_LEAST_LAG_FRAMES, _MOST_LAG_FRAMES + 1):
        pairs = [
            _shifted(h[1:, 1], _motion(p)[:, 0], lag) for h, p in zip(prosody, poses, strict=True)
        ]
        loudness = np.concatenate([pair[0] for pair in pairs])
        speed = np.concatenate([pair[1] for pair in pairs])
        r = float(np.corrcoef(loudness, speed)[0, 1])
        if abs(r) > abs(best[1]):
            best = (lag / RATE_HZ, r)
    return best


def log_psd_distance_db(one: Sequence[Array], other: Sequence[Array]) -> float:
    """Return the rms difference of the poses' power spectra, over axes and 0.8 to 12.5 Hz.

    Parameters
    ----------
    one,other : Sequence[Array]
        (n, 3) each.

    Returns
    -------
    float
        dB.
    """
    ratio = np.log10(_power(one)) - np.log10(_power(other))
    return 10.0 * float(np.sqrt(np.mean(np.square(ratio))))


def _motion(pose: Array) -> Array:
    """(n - 1, 3): speed, velocity of pitch, its amount, in degrees a second."""
    velocity = np.diff(pose, axis=0) * RATE_HZ
    speed = np.sqrt(np.square(velocity).sum(axis=1))
    return np.stack((speed, velocity[:, 0], np.abs(velocity[:, 0])), axis=1)


def _shifted(first: Array, second: Array, lag: int) -> tuple[Array, Array]:
    """The pairs (first[i], second[i + lag])."""
    if lag >= 0:
        return first[: len(first) - lag], second[lag:]
    return first[-lag:], second[:lag]


def _power(poses: Sequence[Array]) -> Array:
    """Welch's mean periodogram (16, 3), means taken away, Hann windows half over one another."""
    window = np.hanning(_PSD_FRAMES)[:, None]
    found = []
    for pose in poses:
        for start in range(0, len(pose) - _PSD_FRAMES + 1, _PSD_FRAMES // 2):
            piece = pose[start : start + _PSD_FRAMES]
            spectrum = np.fft.rfft((piece - piece.mean(axis=0)) * window, axis=0)[1:]
            found.append(np.square(np.abs(spectrum)))
    power: Array = np.mean(found, axis=0)
    return power + _LEAST_POWER


_CUES_PER_FRAME = 4
#: Blinks of what was generated are counted over so long.
_BLINKING_S = 600.0


@dataclass(frozen=True, slots=True)
class HeldOutFigures:
    """Of real held-out tracks, of generated motion, and of generated motion with another's voice.

    canonical_r: first canonical correlation of prosody and head motion; shuffled: recording i with
    the voice of recording i + 1. lag_s: of the head's speed behind loudness; lag_r: how they
    correlate there. psd_distance_db: generated to real; psd_floor_db: one half of the real
    recordings to the other. sd_deg: of pitch, yaw, roll within recordings. blink_per_min and
    blink_median_s are None without lids, or where no two blinks were seen.
    """

    recordings: int
    canonical_r_real: float
    canonical_r_real_shuffled: float
    canonical_r: float
    canonical_r_shuffled: float
    lag_s_real: float
    lag_r_real: float
    lag_s: float
    lag_r: float
    psd_distance_db: float
    psd_floor_db: float
    sd_deg_real: list[float]
    sd_deg: list[float]
    blink_per_min_real: float | None
    blink_median_s_real: float | None
    blink_per_min: float | None
    blink_median_s: float | None

    def as_json(self) -> dict[str, object]:
        """Rounded to four digits."""
        return {
            name: [round(v, 4) for v in value]
            if isinstance(value, list)
            else (round(value, 4) if isinstance(value, float) else value)
            for name, value in asdict(self).items()
        }


def measure_held_out(
    model: ExpressionModel, held_out: Sequence[HeardTrack], seed: int = 0, variety: float = 1.0
) -> HeldOutFigures:
    """The figures of a model; the same seed gives the same. Raises TrackError for fewer than 4."""
    if len(held_out) < 4:
        raise TrackError(f"{len(held_out)} recordings held out; four are the least to measure with")
    prosody = [each.prosody for each in held_out]
    real = [smoothed(each.track.stacked(HEAD)) for each in held_out]
    expression = LearnedExpression(model, np.random.default_rng(seed), variety=variety)
    made = [generated_poses(expression, each) for each in prosody]
    # The voice of another, as long as this one's head.
    others = [
        np.resize(other, each.shape)
        for other, each in zip([*prosody[1:], prosody[0]], prosody, strict=True)
    ]
    lag_s_real, lag_r_real = head_lag_s(prosody, real)
    lag_s, lag_r = head_lag_s(prosody, made)
    per_min_real, median_s_real = _real_blinks(held_out)
    per_min, median_s = _made_blinks(model, seed)
    return HeldOutFigures(
        recordings=len(held_out),
        canonical_r_real=head_correlation(prosody, real),
        canonical_r_real_shuffled=head_correlation(others, real),
        canonical_r=head_correlation(prosody, made),
        canonical_r_shuffled=head_correlation(others, made),
        lag_s_real=lag_s_real,
        lag_r_real=lag_r_real,
        lag_s=lag_s,
        lag_r=lag_r,
        psd_distance_db=log_psd_distance_db(made, real),
        psd_floor_db=log_psd_distance_db(real[::2], real[1::2]),
        sd_deg_real=np.mean([each.std(axis=0) for each in real], axis=0).tolist(),
        sd_deg=np.mean([each.std(axis=0) for each in made], axis=0).tolist(),
        blink_per_min_real=per_min_real,
        blink_median_s_real=median_s_real,
        blink_per_min=per_min,
        blink_median_s=median_s,
    )


def generated_poses(expression: LearnedExpression, prosody: Array) -> Array:
    """Return the poses of a recording with this prosody.

    Parameters
    ----------
    expression : LearnedExpression
        Learned.
    prosody : Array
        (n, 2).

    Returns
    -------
    Array
        (n, 3) degrees: pitch, yaw, roll.
    """
    poses = []
    for pitch_z, loudness_z in prosody.tolist():
        for _ in range(_CUES_PER_FRAME):
            shown = expression.step(ExpressionCue(0.0, _voice(pitch_z, loudness_z)))
        poses.append((shown.neck_pitch_deg, shown.neck_yaw_deg, shown.neck_roll_deg))
    return np.array(poses, dtype=np.float64)


def _voice(pitch_z: float, loudness_z: float) -> VoiceFrame:
    is_silent = loudness_z <= SILENT_Z
    return replace(
        SILENT_VOICE, is_speech=not is_silent, pitch_z=pitch_z, loudness_z=max(loudness_z, SILENT_Z)
    )


def _real_blinks(held_out: Sequence[HeardTrack]) -> tuple[float | None, float | None]:
    if not set(LIDS) <= set(held_out[0].track.values):
        return None, None
    times_s = [blink_times_s(each.track.stacked(LIDS).mean(axis=1)) for each in held_out]
    total_s = sum(each.track.n_frames for each in held_out) / RATE_HZ
    intervals_s = np.concatenate([np.diff(times) for times in times_s])
    median_s = float(np.median(intervals_s)) if len(intervals_s) else None
    return 60.0 * sum(map(len, times_s)) / total_s, median_s


def _made_blinks(model: ExpressionModel, seed: int) -> tuple[float | None, float | None]:
    if model.blinks is None:
        return None, None
    timing = BlinkTiming(*model.blinks, np.random.default_rng(seed))
    shut = [timing.shut(frame / RATE_HZ) for frame in range(round(_BLINKING_S * RATE_HZ))]
    times_s = blink_times_s(np.array(shut))
    median_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else None
    return 60.0 * len(times_s) / _BLINKING_S, median_s


#: Without a list of its own a folder keeps every tenth recording for measuring.
_HELD_OUT_EVERY = 10


def train_expression(
    folder: Path, seed: int = 0, progress: Progress = no_progress
) -> tuple[ExpressionModel, dict[str, object]]:
    """The model, and its figures by name.

    folder: laid out like grid_s1 (it holds landmarks.json), or of CSV files beside sounds. Held out
    are the recordings that `random_test` of its splits.json names, else every tenth. Raises
    TrackError, CorpusError, SoundError.
    """
    tracks = read_tracks(folder, progress)
    check_alike(tracks)
    names = _held_out_names(folder, tracks)
    heard = hear(tracks, progress)
    learned = [each for each in heard if each.track.name not in names]
    if not learned:
        raise TrackError(f"{folder}: every recording is held out")
    progress("learning", 0, 1)
    model = fit_expression(learned, seed)
    progress("learning", 1, 1)
    figures: dict[str, object] = {
        "recordings": len(learned),
        "minutes": round(sum(each.track.n_frames for each in learned) / RATE_HZ / 60.0, 2),
        "held_out": None,
    }
    held_out = [each for each in heard if each.track.name in names]
    if len(held_out) >= 4:
        figures["held_out"] = measure_held_out(model, held_out, seed).as_json()
    return model, figures


def read_tracks(folder: Path, progress: Progress = no_progress) -> list[ExpressionTrack]:
    """The tracks of either kind of folder. Raises TrackError, CorpusError."""
    if (folder / "landmarks.json").is_file():
        return read_grid_tracks(folder, progress)
    return read_track_files(folder, progress)


def _held_out_names(folder: Path, tracks: Sequence[ExpressionTrack]) -> set[str]:
    path = folder / "splits.json"
    if not path.is_file():
        return {track.name for track in tracks[_HELD_OUT_EVERY - 1 :: _HELD_OUT_EVERY]}
    try:
        names = json.loads(path.read_text())["random_test"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TrackError(f"{path}: no list `random_test` of names ({error})") from error
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise TrackError(f"{path}: `random_test` is no list of names")
    return set(names)
