"""How a learned expression moves on recordings that it has not learned from."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from lipservo_lab.learning.expression.expression_fit import blink_times_s, smoothed
from lipservo_lab.learning.expression.motion_measures import (
    head_correlation,
    head_lag_s,
    log_psd_distance_db,
)
from lipservo_lab.learning.expression.tracks import HEAD, LIDS, HeardTrack, TrackError
from lipservo_lab.learning.learned_expression.blink_timing import BlinkTiming
from lipservo_lab.learning.learned_expression.expression_model import RATE_HZ, ExpressionModel
from lipservo_lab.learning.learned_expression.learned_expression import SILENT_Z, LearnedExpression
from lipsync.arrays import Array
from lipsync.expression.cue import ExpressionCue
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame

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
    """Pitch, yaw, roll (n, 3) of the frames of a recording with this prosody (n, 2)."""
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
