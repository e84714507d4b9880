"""Detection of sound that is no voice: the noise of the robot's own servos, and steady sound.

What servos sound like at each speed is learned while the robot listens. The power of each mel band
that servo j adds at speed v is interpolated between a few speeds, and all servos together add up:

    N_b(v_1, ..., v_n) = sum_j sum_s phi_s(v_j) E_jsb

N_b: noise power in band b; E_jsb: power of servo j at the speed knot s; phi_s: the weight of that
knot (`knot_shares`). E is learned only where the network is sure that there is no speech: the mouth
moves with the sound, so noise learned during a voice would contain part of it. Each such frame
moves log N a part of the way to the frame's log power; the step is divided among the E by their
shares of N (normalised least mean squares, Haykin, Adaptive Filter Theory, in logarithms).

Sound that is no louder than the servos are expected to be is explained by them. Nothing is
subtracted from the sound: that made recognition worse (docs/decisions/ears.md).

Hum, buzz, fans and a note held by a machine are steady; no voice is. The floor of each mel band
is the least that it had in the last seconds (minimum statistics, after R. Martin, "Noise power
spectral density estimation", IEEE Trans. Speech and Audio Processing 9(5), 2001), of levels
smoothed over 50 ms. A sound is steady as long as all bands together stay within `_WITHIN_DB` of
their floors: so the floor adapts to any room, and what rises out of it is heard.
"""

from collections import deque

import numpy as np

from lipsync.arrays import Array, Array32
from lipsync.recognition.features import FRAMES_PER_S, N_BANDS

#: Least time between the two readings of a speed: an encoder step of .09 degrees is then 3 deg/s.
_LEAST_S = 0.025
#: Most time between them: readings further apart say nothing about a speed in between.
_MOST_S = 0.2


class ServoSpeeds:
    """Estimator of servo speeds from successive encoder readings."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, Array]] = deque(maxlen=8)

    def take(self, time_s: float, positions_deg: Array) -> tuple[float, Array] | None:
        """Add an encoder reading; return the speeds between it and one at least 25 ms earlier.

        Parameters
        ----------
        time_s : float
            Time of the reading in s; a reading that is not newer than the last is ignored.
        positions_deg : Array
            (n_servos,), NaN for a servo that did not answer.

        Returns
        -------
        tuple[float, Array] | None
            The middle of both times in s, and (n_servos,) in deg/s; None without a reading 25
            to 200 ms earlier, and for a reading that is ignored.
        """
        if self._readings and time_s <= self._readings[-1][0]:
            return None
        speeds = None
        for before_s, before_deg in reversed(self._readings):
            apart_s = time_s - before_s
            if apart_s >= _LEAST_S and len(before_deg) == len(positions_deg):
                if apart_s <= _MOST_S:
                    speeds = (0.5 * (time_s + before_s), (positions_deg - before_deg) / apart_s)
                break
        self._readings.append((time_s, np.array(positions_deg, np.float64)))
        return speeds


#: Speeds between which the sound of a servo is interpolated; below the first it fades to nothing.
_KNOTS_DEG_S = np.array([5.0, 15.0, 40.0, 80.0, 150.0, 300.0])
#: A stored speed is used for sound up to so far from it. Encoders are read 30 times a second at
#: the least.
_LASTS_S = 0.1
_MOST_SPEEDS = 64
#: The power of a servo in a band before anything was learned: too little to count.
_NOTHING = 1e-6
#: Share of a frame's error by which the learned power changes: large at first, then so small that
#: seconds are averaged.
_FIRST_STEP, _LAST_STEP, _SLOWING = 0.5, 0.03, 20.0
#: Errors are clipped to so many natural-log units.
_FURTHEST = 2.0
#: Least probability of silence, by the network, with which a frame is learned from.
SURE_OF_SILENCE = 0.8
#: Sound and what is expected are compared over some 80 ms: single frames of noise scatter.
_SMOOTHING = 0.12
#: How much louder than the noise model a sound may be (mean over the bands, natural log of power)
#: and still be the servos': 3 dB before speech begins. While speech goes on it is 1 dB, for half a
#: second on end, so that its own noise keeps no mouth talking (docs/decisions/ears.md).
_EXPLAINED_AT_REST, _EXPLAINED_AWAKE, _AWAKE_FRAMES = 0.7, 0.25, 50


class OwnNoise:
    """The learned noise of one robot's servos; it is kept from one stream of sound to the next.

    Call `note_speeds` for each reading, `is_own_noise` for each frame in order, and `learn` once a
    frame is known to contain no speech. Memory and time of a call are bounded by the number of
    servos.
    """

    def __init__(self, most_frames: int) -> None:
        """Create the model; `learn` may be called up to `most_frames` frames late."""
        # (sound time, knot weights) by `note_speeds`; (log-mel frame, its knot weights or None).
        self._speeds: deque[tuple[float, Array]] = deque(maxlen=_MOST_SPEEDS)
        self._frames: deque[tuple[Array32, Array | None]] = deque(maxlen=most_frames + 1)
        self._power = np.zeros((0, N_BANDS))  # (n_servos n_knots, n_bands)
        self._n_learned = np.zeros(0)  # frames, weighted, that each row of _power was learned from
        self._excess: float | None = None  # None: the servos were at rest until now
        self._n_explained = 0  # frames on end within the narrower margin

    def begin(self) -> None:
        """Begin a new stream: forget the last one's speeds and frames, keep the learned noise."""
        self._speeds.clear()
        self._frames.clear()
        self._excess, self._n_explained = None, 0

    def note_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """Store the servos' speeds at a sound time; another number of servos forgets the noise.

        Parameters
        ----------
        sound_s : float
            Seconds of sound time.
        speeds_deg_s : Array
            (n_servos,) in deg/s; NaN: not known, counts as 0.
        """
        n = len(speeds_deg_s) * len(_KNOTS_DEG_S)
        if n != len(self._power):
            self._power, self._n_learned = np.full((n, N_BANDS), _NOTHING), np.zeros(n)
            self.begin()
        self._speeds.append((sound_s, knot_shares(speeds_deg_s)))

    def is_own_noise(self, frame: Array32, sound_s: float, *, is_awake: bool) -> bool:
        """Add a frame; return whether its level is within a margin of the moving servos' noise.

        Parameters
        ----------
        frame : Array32
            (40,) log-mel.
        sound_s : float
            Sound time of the frame's middle.
        is_awake : bool
            Whether speech was recognised just before; then the margin is narrower.

        Returns
        -------
        bool
            True: the frame is the robot's own noise; always False while no servo moves.
        """
        shares = self._shares_at(sound_s)
        self._frames.append((frame, shares))
        if shares is None:
            self._excess, self._n_explained = None, 0
            return False
        excess = float(np.mean(frame - np.log(shares @ self._power)))
        previous = excess if self._excess is None else self._excess
        self._excess = previous + _SMOOTHING * (excess - previous)
        self._n_explained = self._n_explained + 1 if self._excess < _EXPLAINED_AWAKE else 0
        is_explained_at_rest = self._excess < _EXPLAINED_AT_REST
        return self._n_explained >= _AWAKE_FRAMES if is_awake else is_explained_at_rest

    def learn(self, n_ago: int) -> None:
        """Learn servo noise from the frame `n_ago` frames before the last, free of speech.

        Does nothing if no servo moved in it, or if that frame is not stored any more.
        """
        if n_ago >= len(self._frames):
            return
        frame, shares = self._frames[-1 - n_ago]
        if shares is None:
            return
        used = shares > 0.0
        # Power of each used (servo, knot) in each band, their sum, and its error to the frame.
        parts = shares[used, None] * self._power[used]
        expected = parts.sum(axis=0)
        log_error = np.clip(frame - np.log(expected), -_FURTHEST, _FURTHEST)
        self._n_learned[used] += shares[used]
        step = np.maximum(_LAST_STEP, _FIRST_STEP / (1.0 + self._n_learned[used] / _SLOWING))
        # Normalised least mean squares: the error times each part's share over the squares' sum.
        correction = parts / expected
        correction /= np.square(correction).sum(axis=0)
        self._power[used] *= np.exp(step[:, None] * correction * log_error)

    def _shares_at(self, sound_s: float) -> Array | None:
        """Return the noise's weights (n_servos n_knots,) at `sound_s`; None if no servo moves."""
        nearest = min(self._speeds, key=lambda entry: abs(entry[0] - sound_s), default=None)
        if nearest is None or abs(nearest[0] - sound_s) > _LASTS_S or not nearest[1].any():
            return None
        return nearest[1]


def knot_shares(speeds_deg_s: Array) -> Array:
    """Return the weight of each servo's noise at each speed knot, by linear interpolation.

    Parameters
    ----------
    speeds_deg_s : Array
        (n_servos,) in deg/s; NaN counts as 0.

    Returns
    -------
    Array
        (n_servos n_knots,), 0 to 1.
    """
    knots = np.concatenate(([0.0], _KNOTS_DEG_S))
    speeds = np.nan_to_num(np.abs(speeds_deg_s), posinf=knots[-1])
    # The speed's position on the axis of knots; a knot's weight falls to 0 at its neighbours.
    knot_position = np.interp(speeds, knots, np.arange(len(knots)))
    shares = np.maximum(0.0, 1.0 - np.abs(knot_position[:, None] - np.arange(1, len(knots))))
    return np.asarray(shares.ravel())


#: Length of the minimum: a vowel that is held so long moves by more than `_WITHIN_DB`.
FLOOR_S = 1.5
#: Longer than any stop closure in a word: hum that is heard in one is no steady sound yet.
STEADY_S = 0.2
_WITHIN_DB = 2.0
_STEP_FRAMES = 10
_STEADY_SMOOTHING = np.float32(0.2)
#: After so many equal frames (digital silence) levels and floors are these frames, to the bit.
_ALL_THE_SAME_FRAMES = 2 * round(FLOOR_S * FRAMES_PER_S)
_DB_PER_NAT = 10.0 / np.log(10.0)


class SteadySoundDetector:
    """Detector of steady sound (hum, fans), frame by frame of 10 ms."""

    def __init__(self) -> None:
        """Start after silence (-100, natural log of power), so that no sound is steady at once."""
        n_steps = round(FLOOR_S * FRAMES_PER_S) // _STEP_FRAMES
        self._minima = np.full((n_steps, N_BANDS), -100.0, np.float32)
        self._level: Array32 = np.full(N_BANDS, -100.0, np.float32)
        self._n_frames = self._n_near_floor = self._n_same = 0
        self._last_frame: Array32 = self._level
        self._floor: Array32 = self._minima[0].copy()

    def push(self, frame: Array32) -> bool:
        """Add a frame; return whether the sound has been steady for `STEADY_S` (0.2 s).

        Parameters
        ----------
        frame : Array32
            (40,): natural log of power.

        Returns
        -------
        bool
            True from then on, for as long as it stays steady.
        """
        self._n_same = self._n_same + 1 if np.array_equal(frame, self._last_frame) else 0
        self._last_frame = frame
        if self._n_same > _ALL_THE_SAME_FRAMES:
            self._n_frames += 1
            return True
        self._level = self._level + _STEADY_SMOOTHING * (frame - self._level)
        # The floor: minimum over a ring of steps of 100 ms, of which one is being filled.
        step, within = divmod(self._n_frames, _STEP_FRAMES)
        minimum = self._minima[step % len(self._minima)]
        if within == 0:
            minimum[:] = self._level
            self._floor = self._minima.min(axis=0)
        else:
            np.minimum(minimum, self._level, out=minimum)
            np.minimum(self._floor, self._level, out=self._floor)
        self._n_frames += 1
        above_db = float(np.mean(self._level - self._floor)) * _DB_PER_NAT
        self._n_near_floor = self._n_near_floor + 1 if above_db < _WITHIN_DB else 0
        return self._n_near_floor >= round(STEADY_S * FRAMES_PER_S)
