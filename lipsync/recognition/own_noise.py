"""Detection of sound that is no voice: the noise of the robot's own servos, and steady sound.

What servos sound like at each speed is learned while the robot listens. The power of each mel band
that servo j adds at speed v is interpolated between a few speeds, and all servos together add up:

    N_b(v_1, ..., v_n) = sum_j sum_s phi_s(v_j) E_jsb

E is learned only where the network is sure that there is no speech: the mouth moves with the sound,
so that what is learned beside a voice is partly that voice. Each such frame moves log N a part of
the way to the power heard, shared among the E as they share in N
(normalised least mean squares, Haykin, Adaptive Filter Theory, in logarithms).

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

#: Over so much time at least: an encoder step of .09 degrees is then 3 deg/s.
_LEAST_S = 0.025
#: Places further apart than this say nothing about a speed in between.
_MOST_S = 0.2


class ServoSpeeds:
    """Estimator of servo speeds from successive encoder readings."""

    def __init__(self) -> None:
        self._read: deque[tuple[float, Array]] = deque(maxlen=8)

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
        if self._read and time_s <= self._read[-1][0]:
            return None
        found = None
        for before_s, before_deg in reversed(self._read):
            apart_s = time_s - before_s
            if apart_s >= _LEAST_S and len(before_deg) == len(positions_deg):
                if apart_s <= _MOST_S:
                    found = (0.5 * (time_s + before_s), (positions_deg - before_deg) / apart_s)
                break
        self._read.append((time_s, np.array(positions_deg, np.float64)))
        return found


#: Speeds between which the sound of a servo is interpolated; below the first it fades to nothing.
_KNOTS_DEG_S = np.array([5.0, 15.0, 40.0, 80.0, 150.0, 300.0])
#: A speed that is told counts so long. Encoders are read 30 times a second at the least.
_LASTS_S = 0.1
_MOST_SPEEDS = 64
#: The power that a servo is thought to add before anything was learned: nothing that counts.
_NOTHING = 1e-6
#: How far towards a frame what is known moves: far at first, then so that seconds are averaged.
_FIRST_STEP, _LAST_STEP, _SLOWING_FRAMES = 0.5, 0.03, 20.0
_FURTHEST = 2.0
#: So sure the network must be that nobody spoke.
SURE_OF_SILENCE = 0.8
#: Sound and what is expected are compared over some 80 ms: single frames of noise scatter.
_SMOOTHING = 0.12
#: The mean over the bands by which sound may be louder than expected and still be the servos', in
#: natural logarithms of power: 3 dB before the mouth wakes. While somebody speaks it is 1 dB, for
#: half a second on end, so that its own noise keeps no mouth talking (docs/decisions/ears.md).
_EXPLAINED_AT_REST, _EXPLAINED_AWAKE, _AWAKE_FRAMES = 0.7, 0.25, 50


class OwnNoise:
    """The learned noise of one robot's servos; it is kept from one stream of sound to the next.

    Call `note_speeds` for each reading, `explains` for each frame in order, `learn` once a frame is
    known to contain no speech. Memory and time of a call are bounded by the number of servos.
    """

    def __init__(self, most_frames: int) -> None:
        """Create the model; `learn` may be called up to `most_frames` frames late."""
        self._speeds: deque[tuple[float, Array]] = deque(maxlen=_MOST_SPEEDS)
        self._heard: deque[tuple[Array32, Array | None]] = deque(maxlen=most_frames + 1)
        self._power = np.zeros((0, N_BANDS))  # (n_servos n_knots, n_bands)
        self._n_learned = np.zeros(0)
        self._louder: float | None = None  # None: the servos were at rest until now
        self._n_explained = 0  # frames on end within the narrower margin

    def begin(self) -> None:
        """Begin a new stream: forget the last one's speeds and frames, keep the learned noise."""
        self._speeds.clear()
        self._heard.clear()
        self._louder, self._n_explained = None, 0

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

    def explains(self, frame: Array32, sound_s: float, *, is_awake: bool) -> bool:
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
        self._heard.append((frame, shares))
        if shares is None:
            self._louder, self._n_explained = None, 0
            return False
        louder = float(np.mean(frame - np.log(shares @ self._power)))
        before = louder if self._louder is None else self._louder
        self._louder = before + _SMOOTHING * (louder - before)
        self._n_explained = self._n_explained + 1 if self._louder < _EXPLAINED_AWAKE else 0
        if is_awake:
            return self._n_explained >= _AWAKE_FRAMES
        return self._louder < _EXPLAINED_AT_REST

    def learn(self, n_ago: int) -> None:
        """Learn servo noise from the frame `n_ago` frames before the last, free of speech."""
        if n_ago >= len(self._heard):
            return
        frame, shares = self._heard[-1 - n_ago]
        if shares is None:
            return
        used = shares > 0.0
        parts = shares[used, None] * self._power[used]
        expected = parts.sum(axis=0)
        off = np.clip(frame - np.log(expected), -_FURTHEST, _FURTHEST)
        self._n_learned[used] += shares[used]
        step = np.maximum(_LAST_STEP, _FIRST_STEP / (1.0 + self._n_learned[used] / _SLOWING_FRAMES))
        share = parts / expected
        share /= np.square(share).sum(axis=0)
        self._power[used] *= np.exp(step[:, None] * share * off)

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
    place = np.interp(speeds, knots, np.arange(len(knots)))
    shares = np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(1, len(knots))))
    return np.asarray(shares.ravel())


#: A vowel is not held so long without its bands moving by more than `_WITHIN_DB`.
FLOOR_S = 1.5
#: Longer than any closure in a word: these must not be taken for the hum behind them.
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
        n_steps = round(FLOOR_S * FRAMES_PER_S) // _STEP_FRAMES
        # Before the stream there was silence: what begins at once is no steady sound yet.
        self._minima = np.full((n_steps, N_BANDS), -100.0, np.float32)
        self._level: Array32 = np.full(N_BANDS, -100.0, np.float32)
        self._n_frames = self._n_near_floor = self._n_same = 0
        self._last: Array32 = self._level
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
        self._n_same = self._n_same + 1 if np.array_equal(frame, self._last) else 0
        self._last = frame
        if self._n_same > _ALL_THE_SAME_FRAMES:
            self._n_frames += 1
            return True
        self._level = self._level + _STEADY_SMOOTHING * (frame - self._level)
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
