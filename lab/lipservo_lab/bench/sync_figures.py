"""How far the mouth is from its sound on servos that are late, with and without compensation."""

from dataclasses import dataclass

import numpy as np

from calibration.calibration import Calibration
from calibration.fit.servo_response import lag_between_s
from calibration.run.following import Follower
from calibration.simulated.robot import RobotDraw, true_markers_mm
from calibration.simulated.servos import SimulatedServos
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47
from lipsync.phonemes import SILENCE

_RATE_HZ = 100.0
LOOK_AHEAD_S = 0.200
#: Phones of speech last about this long (GRID and TIMIT: 80 to 100 ms on average).
_PHONE_S = 0.09
_N_PHONES, _PHONES_A_WALK = 220, 8
#: The error is taken in windows of this length, twice as many as fit end to end.
_WINDOW_S = 2.0


@dataclass(frozen=True, slots=True)
class SyncErrors:
    """Time between the speaker's lip gap and the robot's, rms over windows.

    gap_r: correlation of the two gaps in motion, after compensation.
    """

    before_rms_ms: float
    after_rms_ms: float
    gap_r: float


def sync_errors(
    model: FaceWithAnimPhos,
    calibration: Calibration,
    draw: RobotDraw,
    servos: SimulatedServos,
    seed: int,
) -> SyncErrors:
    """Twenty seconds of AnimPhos, through map, follower, late servos and backlash."""
    motion = _motion(model, np.random.default_rng([seed, 3]))
    wanted_mm = np.array([model.lip_gap_mm(frame) for frame in motion])
    poses_deg = np.array([calibration.positions_deg(frame) for frame in motion])
    before_mm = _gap_mm(draw, servos, poses_deg)
    follower = Follower(
        calibration.following, poses_deg.shape[1], 1.0 / _RATE_HZ, look_ahead_s=LOOK_AHEAD_S
    )
    goals_deg = np.array([follower.feed(pose) for pose in poses_deg])
    # Fed in advance: what is asked for at one instant is shown so much later.
    early = round(follower.advance_s * _RATE_HZ)
    after_mm = _gap_mm(draw, servos, goals_deg)
    late_s = _lags_s(wanted_mm, after_mm) - follower.advance_s
    shown = slice(early, None)
    return SyncErrors(
        before_rms_ms=_rms(_lags_s(wanted_mm, before_mm)) * 1e3,
        after_rms_ms=_rms(late_s) * 1e3,
        gap_r=float(np.corrcoef(wanted_mm[: len(after_mm) - early], after_mm[shown])[0, 1]),
    )


def _motion(model: FaceWithAnimPhos, rng: np.random.Generator) -> Array:
    """(n, n_components) at 100 Hz: walks without pauses through AnimPhos that may follow.

    Each walk is short, as some AnimPhos lead round in a circle, and of a motion that repeats itself
    nobody can say how late it is.
    """
    speaking = np.setdiff1d(np.arange(len(model.animphos)), model.animphos.of_phoneme(SILENCE))
    animpho = int(rng.choice(speaking))
    frames = [model.rest[None]]
    for phone in range(_N_PHONES):
        frames.append(model.animphos.samples[animpho, 1:-1])
        following = np.intersect1d(model.animphos.successors[animpho], speaking)
        goes_on = len(following) > 0 and (phone + 1) % _PHONES_A_WALK > 0
        animpho = int(rng.choice(following if goes_on else speaking))
    keys = np.concatenate(frames)
    key_s = np.arange(len(keys)) * _PHONE_S / 3
    times_s = np.arange(0.0, key_s[-1], 1.0 / _RATE_HZ)
    return np.stack([np.interp(times_s, key_s, column) for column in keys.T], axis=1)


def _gap_mm(draw: RobotDraw, servos: SimulatedServos, goals_deg: Array) -> Array:
    """(n,): the robot's lip gap, shafts late and horns with backlash."""
    shafts_deg = servos.shafts_deg(goals_deg, _RATE_HZ)
    horns_deg = np.empty_like(shafts_deg)
    horn, half_deg = shafts_deg[0], draw.backlash_deg / 2
    for n, shaft in enumerate(shafts_deg):
        horn = np.clip(horn, shaft - half_deg, shaft + half_deg)
        horns_deg[n] = horn
    markers_mm = true_markers_mm(draw, horns_deg)
    return np.asarray(
        markers_mm[:, MARKERS_47.upper_lip, 1] - markers_mm[:, MARKERS_47.lower_lip, 1]
    )


def _lags_s(wanted: Array, seen: Array) -> Array:
    """(n_windows,): how much later `seen` is, window by window."""
    length = round(_WINDOW_S * _RATE_HZ)
    starts = range(0, len(wanted) - length, length // 2)
    return np.array(
        [lag_between_s(wanted[s : s + length], seen[s : s + length], _RATE_HZ) for s in starts]
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
