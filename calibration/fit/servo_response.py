"""Measurement of how each servo follows its goal: lag, speed and bandwidth by chirp and step."""

from collections.abc import Callable, Sequence

import numpy as np

from calibration.calibration import CalibrationError, Following
from calibration.mouth_servos import JointRange
from lipsync.arrays import Array

#: Send goals (n, n_servos), one each 1 / rate_hz, and give back the encoders at the same instants.
Drive = Callable[[Array, float], Array]

#: Where the driver says nothing else.
RATE_HZ = 100.0
#: Speech moves a jaw at 4 to 6 Hz, with little above 8: the chirp ends beyond that.
CHIRP_END_HZ = 12.0
_CHIRP_HZ, _CHIRP_S = (0.5, CHIRP_END_HZ), 10.0
#: Lags count where speech moves: the chirp up to here.
_SPEECH_HZ = 6.0
#: As far as lips go in speech, and no more than a third of what the joint may do.
_CHIRP_DEG, _STEP_DEG = 5.0, 25.0
_PAUSE_S, _STEP_S = 0.5, 1.0
_LONGEST_LAG_S = 0.3
#: Half power, by which bandwidths are given.
_HALF_POWER = 10 ** (-3 / 20)
#: Gain is averaged over so many periods around each frequency.
_PERIODS = 3.0


def chirp_deg(amplitude_deg: float, rate_hz: float = RATE_HZ) -> Array:
    """Return a sine whose frequency grows linearly from 0.5 to 12 Hz in 10 s, between two rests.

    Parameters
    ----------
    amplitude_deg : float
        Amplitude of the sine.
    rate_hz : float
        Goals per second.

    Returns
    -------
    Array
        (n,) degrees.
    """
    times_s = np.arange(0.0, _CHIRP_S, 1.0 / rate_hz)
    low, high = _CHIRP_HZ
    phase_turns = low * times_s + (high - low) * times_s**2 / (2 * _CHIRP_S)
    rest = np.zeros(round(_PAUSE_S * rate_hz))
    return np.concatenate([rest, amplitude_deg * np.sin(2 * np.pi * phase_turns), rest])


def chirp_amplitude_deg(joint: JointRange) -> float:
    """Return a joint's amplitude of the chirp in degrees: 5, or a third of a smaller range."""
    return min(_CHIRP_DEG, (joint.max_deg - joint.min_deg) / 3.0)


def identify(
    drive: Drive,
    joints: Sequence[JointRange],
    backlash_deg: Array,
    *,
    rate_hz: float = RATE_HZ,
    progress: Callable[[int], None] = lambda _: None,
) -> Following:
    """Measure how each joint follows a chirp and two steps, the other joints resting at 0.

    Parameters
    ----------
    drive : Drive
        Sends goals (n, n_servos) at a rate in Hz; returns the encoders' angles, (n, n_servos).
    joints : Sequence[JointRange]
        Ranges of the joints.
    backlash_deg : Array
        (n_servos,) degrees, passed on to the result.
    rate_hz : float
        Goals per second: at least 50, or the fastest part of the chirp is lost.
    progress : Callable[[int], None]
        Called with the number of joints done.

    Returns
    -------
    Following
        Lags in s, speeds in deg/s and bandwidths in Hz.

    Raises
    ------
    CalibrationError
        A joint's encoder does not follow.
    """
    figures = []
    for joint in range(len(joints)):
        figures.append(_identify_joint(drive, joints, joint, rate_hz))
        progress(joint + 1)
    lag_s, bandwidth_hz, top_speed_deg_s = np.array(figures).T
    return Following(lag_s, backlash_deg, top_speed_deg_s, bandwidth_hz)


def _identify_joint(
    drive: Drive, joints: Sequence[JointRange], joint: int, rate_hz: float
) -> tuple[float, float, float]:
    """Drive one joint by a chirp, then steps; return lag in s, bandwidth in Hz, top speed in deg/s.

    joint: the joint's number; the others are sent to 0 degrees. rate_hz: goals per second. Takes
    14 s. Raises CalibrationError for a joint that moves less than a tenth of the chirp.
    """
    limits = joints[joint]
    middle_deg = (limits.min_deg + limits.max_deg) / 2
    chirp = chirp_deg(chirp_amplitude_deg(limits), rate_hz)
    encoder_deg = _drive_one(drive, middle_deg + chirp, joint, len(joints), rate_hz) - middle_deg
    lag_s = lag_between_s(chirp, encoder_deg, rate_hz, until=_chirp_index(_SPEECH_HZ, rate_hz))
    if np.std(encoder_deg) < 0.1 * np.std(chirp):
        raise CalibrationError(
            f"servo {limits.name!r} does not follow its goal; is torque on, is it stuck?"
        )
    far_deg = min(_STEP_DEG, limits.max_deg - limits.min_deg) / 2
    n_samples = round(_STEP_S * rate_hz)
    steps_deg = middle_deg + np.repeat([-far_deg, far_deg, -far_deg], n_samples)
    speeds_deg_s = np.diff(_drive_one(drive, steps_deg, joint, len(joints), rate_hz)) * rate_hz
    return lag_s, _bandwidth_hz(chirp, encoder_deg, rate_hz), float(np.abs(speeds_deg_s).max())


def _drive_one(drive: Drive, goals_deg: Array, joint: int, n_servos: int, rate_hz: float) -> Array:
    """Send goals_deg, (n,), to one joint and 0 to the others; return its encoder's angles, (n,)."""
    goals = np.zeros((len(goals_deg), n_servos))
    goals[:, joint] = goals_deg
    return drive(goals, rate_hz)[:, joint]


def lag_between_s(goal: Array, seen: Array, rate_hz: float, *, until: int | None = None) -> float:
    """Return by how much one signal is later than another: the shift of best correlation.

    Shifts between samples are interpolated; they are at most 0.3 s.

    Parameters
    ----------
    goal,seen : Array
        (n,), in one unit.
    rate_hz : float
        Samples per second.
    until : int | None
        Only goals before this sample count; None: all.

    Returns
    -------
    float
        Seconds, positive where `seen` is later.
    """
    longest = min(round(_LONGEST_LAG_S * rate_hz), len(goal) // 2)
    end = min(until or len(goal), len(goal) - longest)
    template = goal[longest:end] - goal[longest:end].mean()
    shifts = np.arange(-longest, longest + 1)
    scores = np.empty(len(shifts))
    # Correlation of the goal with the other signal, shifted by so many samples.
    for i, shift in enumerate(shifts):
        window = seen[longest + shift : end + shift]
        window = window - window.mean()
        scores[i] = template @ window / (np.linalg.norm(window) * np.linalg.norm(template) + 1e-12)
    best_index = int(scores[1:-1].argmax()) + 1
    before, peak, after = scores[best_index - 1 : best_index + 2]
    # The peak of the parabola through the best score and its two neighbours.
    curvature = before - 2 * peak + after
    fraction = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
    return float((shifts[best_index] + fraction) / rate_hz)


def _chirp_index(frequency_hz: float, rate_hz: float) -> int:
    """Return the index of the sample of `chirp_deg` at which its sine reaches frequency_hz."""
    low, high = _CHIRP_HZ
    return round((_PAUSE_S + (frequency_hz - low) / (high - low) * _CHIRP_S) * rate_hz)


def _bandwidth_hz(chirp: Array, seen: Array, rate_hz: float) -> float:
    """Return the lowest frequency at which the angle `seen` has half the power of the goal `chirp`.

    The chirp's highest frequency if there is none. rate_hz: samples per second.
    """
    highest_hz = _CHIRP_HZ[1]
    for frequency_hz in np.arange(1.0, highest_hz, 0.25):
        centre = _chirp_index(frequency_hz, rate_hz)
        half_width = round(_PERIODS / 2 / frequency_hz * rate_hz)
        window = slice(max(0, centre - half_width), centre + half_width)
        if np.std(seen[window]) < _HALF_POWER * np.std(chirp[window]):
            return float(frequency_hz)
    return highest_hz
