"""Whether a calibrated mouth stays within its joints' speeds while it speaks, as `run` moves it.

AnimPhos, the speaker's recorded shapes of phonemes, in orders that may follow each other, are
mapped to joint angles, with backlash made up for. `JointPlan` then limits them to each joint's
`max_speed_deg_s`, giving priority to closures (lips that meet); those that remain are counted.
"""

from dataclasses import dataclass

import numpy as np

from calibration.calibration import Calibration
from calibration.closure import CLOSED_GAP_MM
from calibration.run.compensation import BacklashCompensation
from firmware_bridge.gate.joint_plan import JointPlan, TargetWindow
from lipservo.settings.settings import FaceSettings
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.phonemes import SILENCE

_PERIOD_S = 0.01
#: Phones of speech last about this long (GRID and TIMIT: 80 to 100 ms on average).
_PHONE_S = 0.09
_N_PHONES, _PHONES_PER_WALK = 220, 8
#: What is known ahead by default, and where a window has poses.
_WINDOW_S = np.array([0.0, 0.05, 0.1])
_WITHIN_SHARE = 0.01
_STRENGTHS = np.arange(1.0, 0.35, -0.05)
#: A closure counts as met where lips would be no farther apart.
_REACHED_MM = 0.1


@dataclass(frozen=True, slots=True)
class WithinSpeeds:
    """How often speech exceeds joints' speeds, in shares of its frames, 0..1.

    beyond: of any joint; slowest_beyond: of the worst one, `slowest`. reached_closures: of the
    closures (lips that meet) that the map reaches, the share still reached at limited speeds; None:
    no contact is known, or the map reaches none. strength: the largest `lipservo set strength` that
    keeps 99 % of the frames within speeds; None: not even 0.4 does.
    """

    beyond: float
    slowest: str
    slowest_beyond: float
    reached_closures: float | None
    strength: float | None


def within_speeds(
    model: FaceWithAnimPhos, calibration: Calibration, settings: FaceSettings
) -> WithinSpeeds:
    """Simulate twenty seconds of speech; return how often the servos' speeds are exceeded."""
    speeds = [settings.servos[name].max_speed_deg_s for name in calibration.servo_names]
    speeds_deg_s = np.array(speeds)
    if calibration.following is not None:
        speeds_deg_s = np.minimum(speeds_deg_s, calibration.following.top_speed_deg_s)
    faces = spoken_frames(model, np.random.default_rng([0, 3]))
    goals_deg = _goals_with_backlash_deg(calibration, faces)
    exceeds = _exceeds_speeds(calibration.poses_deg(faces), speeds_deg_s)
    worst = int(exceeds.mean(axis=0).argmax())
    return WithinSpeeds(
        beyond=float(exceeds.any(axis=1).mean()),
        slowest=calibration.servo_names[worst],
        slowest_beyond=float(exceeds[:, worst].mean()),
        reached_closures=_reached_share(model, calibration, faces, goals_deg, speeds_deg_s),
        strength=_largest_strength(model, calibration, faces, speeds_deg_s),
    )


def spoken_frames(model: FaceWithAnimPhos, rng: np.random.Generator) -> Array:
    """Return random speech: walks without pauses through AnimPhos that may follow each other.

    AnimPhos are recorded pieces of motion, each about one phoneme. A walk ends after eight: some
    successions of AnimPhos form a circle, and the lag of a motion that repeats itself cannot be
    measured.

    Parameters
    ----------
    model : FaceWithAnimPhos
        Model with the AnimPhos.
    rng : np.random.Generator
        Chooses each next AnimPho.

    Returns
    -------
    Array
        (n, n_components) at 100 Hz.
    """
    speaking = np.setdiff1d(np.arange(len(model.animphos)), model.animphos.of_phoneme(SILENCE))
    animpho = int(rng.choice(speaking))
    frames = [model.rest[None]]
    for phone in range(_N_PHONES):
        frames.append(model.animphos.samples[animpho, 1:-1])
        successors = np.intersect1d(model.animphos.successors[animpho], speaking)
        may_continue = len(successors) > 0 and (phone + 1) % _PHONES_PER_WALK > 0
        animpho = int(rng.choice(successors if may_continue else speaking))
    key_frames = np.concatenate(frames)
    # Three frames a phone, resampled to 100 Hz.
    key_s = np.arange(len(key_frames)) * _PHONE_S / 3
    times_s = np.arange(0.0, key_s[-1], _PERIOD_S)
    return np.stack([np.interp(times_s, key_s, column) for column in key_frames.T], axis=1)


def _goals_with_backlash_deg(calibration: Calibration, faces: Array) -> Array:
    """Return the goals of faces, (n, n_servos) degrees, shifted to make up for backlash.

    faces: (n, n_components) at 100 Hz.
    """
    poses_deg = calibration.poses_deg(faces)
    following = calibration.following
    if following is None:
        return poses_deg
    compensation = BacklashCompensation(following.backlash_deg)
    return np.array([compensation.feed(pose_deg[None])[0] for pose_deg in poses_deg])


def _exceeds_speeds(goals_deg: Array, speeds_deg_s: Array) -> Array:
    """Return whether each step between frames is faster than a joint may turn, (n - 1, n_servos).

    goals_deg: (n, n_servos) at 100 Hz; speeds_deg_s: (n_servos,).
    """
    return np.asarray(np.abs(np.diff(goals_deg, axis=0)) / _PERIOD_S > speeds_deg_s)


def _largest_strength(
    model: FaceWithAnimPhos, calibration: Calibration, faces: Array, speeds_deg_s: Array
) -> float | None:
    """Return the largest motion strength at which 99 % of frames keep within the joints' speeds.

    faces: (n, n_components) at 100 Hz; speeds_deg_s: (n_servos,), the limits. Strengths from 1 down
    to 0.4 are tried; None: not even the least of them keeps within. Backlash is left out.
    """
    for strength in _STRENGTHS.tolist():
        goals_deg = calibration.poses_deg(model.rest + strength * (faces - model.rest))
        if _exceeds_speeds(goals_deg, speeds_deg_s).any(axis=1).mean() <= _WITHIN_SHARE:
            return float(round(strength, 2))
    return None


def _reached_share(
    model: FaceWithAnimPhos,
    calibration: Calibration,
    faces: Array,
    goals_deg: Array,
    speeds_deg_s: Array,
) -> float | None:
    """Return the share of reachable closures still reached at limited joint speeds, 0 to 1.

    faces: (n, n_components) at 100 Hz; goals_deg: (n, n_servos), their joint angles; speeds_deg_s:
    (n_servos,), the limits. A closure is reached if the lips come within 0.1 mm. None: the lip
    contact is not known, or no closure is reachable.
    """
    if calibration.closure is None:
        return None
    is_closed = model.lip_gaps_mm(model.markers_mm(faces)) <= CLOSED_GAP_MM
    plan = JointPlan(speeds_deg_s, np.full(len(speeds_deg_s), np.inf), _PERIOD_S)
    ahead_frames = np.round(_WINDOW_S / _PERIOD_S).astype(np.int64)
    sent_deg = []
    # As in a run: each frame the plan gets goals now and up to 0.1 s ahead.
    for n in range(len(goals_deg)):
        rows = np.minimum(n + ahead_frames, len(goals_deg) - 1)
        sent_deg.append(plan.step(TargetWindow(_WINDOW_S, goals_deg[rows], is_closed[rows])))
    # First and last frames of each closure of the speaker's lips.
    first_frames = np.flatnonzero(np.diff(is_closed.astype(np.int64), prepend=0) == 1)
    last_frames = np.flatnonzero(np.diff(is_closed.astype(np.int64), append=0) == -1)
    wanted_mm = calibration.closure.open_mm(goals_deg)[:, 0]
    shown_mm = calibration.closure.open_mm(np.array(sent_deg))[:, 0]
    reached = [
        shown_mm[first : last + 1].min() <= _REACHED_MM
        for first, last in zip(first_frames, last_frames, strict=True)
        if wanted_mm[first : last + 1].min() <= _REACHED_MM
    ]
    return float(np.mean(reached)) if reached else None


def speed_line(found: WithinSpeeds) -> str:
    """Return `found`, how often speech exceeds joints' speeds, as one line for a person."""
    reached = found.reached_closures
    closures = ""
    if reached is not None:
        closures = f"; behind the plan of joint motion {reached:.0%} of closures are met"
    if found.beyond <= _WITHIN_SHARE:
        return (
            f"speeds: no more than {found.beyond:.0%} of speech asks a joint for too much{closures}"
        )
    strength = ""
    if found.strength is not None:
        strength = f"; a strength of {found.strength:g} keeps within"
    elif reached is None or reached < 1.0 - _WITHIN_SHARE:
        # Where the plan, which begins motions earlier, reaches all closures, it keeps within.
        strength = "; no strength keeps within"
    return (
        f"speeds: {found.beyond:.0%} of speech asks a joint for more than its max_speed_deg_s, "
        f"most often {found.slowest} ({found.slowest_beyond:.0%}){closures}{strength}"
    )
