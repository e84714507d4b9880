"""What the bench does to speech before it is heard: noise, babble, another level or line.

Speech in a room with six walls: the image method of Allen and Berkley (1979).

Each wall is a mirror that takes a part of the sound; a microphone gets the talker and all mirror
images of the talker, each as late and as faint as it is far. Training draws rooms of other sizes,
with images for 50 ms only (noise.py).

The sound of a robot's own servos, and how fast each turned while it was made.

The motion is that of a mouth: every joint goes from place to place along minimum-jerk courses,
some five a second while the robot talks, and stands still in between. What is heard of a servo is
made from its speed alone: the mesh of each pair of gears as a tone whose height is the speed, the
brushes as a rush that the motor's turning modulates, the load as a growl, all through the shell of
a head. So the same speed always sounds much the same, as it does with real gears.

Made otherwise than the servos of the training (training/nonspeech_sounds.py), in motion, gears
and shell, so that no network was trained on its like.
"""

import zlib
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from firmware_bridge.dynamixel.control_table import servo_models
from lipservo_lab.learning.recognition import noise
from lipservo_lab.learning.recognition.noise import unit_power
from lipsync.arrays import Array, Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.recognition.features import FRAMES_PER_S

#: An office: length, width and height, and what part of the pressure each wall gives back. Its
#: sound falls by 60 dB in half a second.
_SIZE_M, _WALLS_KEEP = np.array([5.2, 4.1, 2.7]), 0.85
_LONGEST_S = 0.6
#: Where the microphone stands; how far away somebody speaks, and no nearer to a wall than so.
_LOW_M, _HIGH_M, _AWAY_M, _FROM_WALLS_M = (1.0, 1.0, 1.0), (4.2, 3.1, 1.6), (0.7, 1.8), 0.5
#: Tried until somebody stands so far away within the walls.
_N_PLACES = 50


def in_room(rng: np.random.Generator, speech: Array32) -> Array32:
    """Return speech as a microphone somewhere in a room gets it.

    Time and level of the direct sound stay.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the room.
    speech : Array32
        (n,).

    Returns
    -------
    Array32
        (n,).
    """
    heard_m = rng.uniform(_LOW_M, _HIGH_M)
    direction = rng.normal(size=3) * [1.0, 1.0, 0.2]
    spoken_m = heard_m + rng.uniform(*_AWAY_M) * direction / np.linalg.norm(direction)
    spoken_m = np.clip(spoken_m, _FROM_WALLS_M, _SIZE_M - _FROM_WALLS_M)
    response = impulse_response(spoken_m, heard_m)
    return _heard_through(response, int(response.argmax()), speech)


def in_room_from(rng: np.random.Generator, speech: Array32, away_m: float) -> Array32:
    """The same, spoken so far away (within 15 %): what comes first is the direct sound."""
    heard_m = rng.uniform(_LOW_M, _HIGH_M)
    for _ in range(_N_PLACES):
        direction = rng.normal(size=3) * [1.0, 1.0, 0.2]
        spoken_m = heard_m + away_m * direction / np.linalg.norm(direction)
        spoken_m = np.clip(spoken_m, _FROM_WALLS_M, _SIZE_M - _FROM_WALLS_M)
        if abs(np.linalg.norm(spoken_m - heard_m) - away_m) < 0.15 * away_m:
            break
    response = impulse_response(spoken_m, heard_m)
    return _heard_through(response, int(np.flatnonzero(response)[0]), speech)


def _heard_through(response: Array, direct: int, speech: Array32) -> Array32:
    n_fft = 1 << (len(speech) + len(response)).bit_length()
    spectrum = np.fft.rfft(speech, n_fft) * np.fft.rfft(response[direct:] / response[direct], n_fft)
    return np.fft.irfft(spectrum, n_fft)[: len(speech)].astype(np.float32)


def impulse_response(spoken_m: Array, heard_m: Array) -> Array:
    """Return what one click is at the microphone, until it has died away.

    Parameters
    ----------
    spoken_m,heard_m : Array
        (3,): where.

    Returns
    -------
    Array
        (n,) samples at 16 kHz.
    """
    far_m, n_walls = noise.images(_SIZE_M, spoken_m, heard_m, _LONGEST_S)
    level = _WALLS_KEEP**n_walls / far_m
    at = np.rint(far_m / noise.SOUND_M_S * SAMPLE_RATE_HZ).astype(np.int64)
    in_time = at < round(_LONGEST_S * SAMPLE_RATE_HZ)
    return np.asarray(np.bincount(at[in_time], weights=level[in_time]), dtype=np.float64)


_N_SERVOS = 8
#: A joint of the mouth seldom turns faster (docs/benchmarks.md, the fastest lip apart).
_WIDEST_DEG = 14.0
#: Turns of the motor for one of the horn, and teeth that mesh a turn of the motor: XL330 and its
#: like have ratios of 250 to 350.
_RATIO, _TEETH = (250.0, 350.0), (9, 12, 14)
_HOP = SAMPLE_RATE_HZ // FRAMES_PER_S


def servo_noise(rng: np.random.Generator, n: int, robot: int = 0) -> tuple[Array32, Array]:
    """Return the noise of a robot's servos, and their speeds.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the motion.
    n : int
        Samples.
    robot : int
        Its number; servos and shell are drawn from it.

    Returns
    -------
    tuple[Array32, Array]
        (n,) of unit power; (n // 160, 8), a row each 10 ms, in deg/s.
    """
    build = np.random.default_rng(robot)
    n_frames = n // _HOP
    talks = _talks(rng, n_frames)
    speeds = np.stack([_speeds_deg_s(rng, talks) for _ in range(_N_SERVOS)], axis=1)
    sound = np.zeros(n)
    at = np.arange(n) / _HOP
    for joint in range(_N_SERVOS):
        speed = np.abs(np.interp(at, np.arange(n_frames) + 0.5, speeds[:, joint]))
        sound += build.uniform(0.4, 1.2) * _servo(build, rng, speed)
    for _ in range(3):
        sound = _shell(build, sound)
    hiss = 0.01 * np.std(sound) * rng.standard_normal(n)
    return unit_power(sound + hiss), speeds


def encoder_readings_deg(speeds_deg_s: Array) -> Array:
    """Return where encoders of XL330 see the joints at the end of each 10 ms.

    Parameters
    ----------
    speeds_deg_s : Array
        (n_frames, n_servos).

    Returns
    -------
    Array
        (n_frames, n_servos) degrees.
    """
    step_deg = 1.0 / servo_models()["XL330-M288"].pulses_per_deg
    places_deg = np.cumsum(speeds_deg_s, axis=0) / FRAMES_PER_S
    return np.asarray(np.rint(places_deg / step_deg) * step_deg)


def _talks(rng: np.random.Generator, n_frames: int) -> Array:
    """Draw when the robot talks, (n_frames,): 1 while it talks, 0 in its pauses."""
    talks = np.zeros(n_frames)
    at, is_talking = 0, bool(rng.random() < 0.5)
    while at < n_frames:
        length = int(rng.uniform(*((0.8, 3.0) if is_talking else (0.3, 1.2))) * FRAMES_PER_S)
        talks[at : at + length] = is_talking
        at, is_talking = at + length, not is_talking
    return talks


def _speeds_deg_s(rng: np.random.Generator, talks: Array) -> Array:
    """Return speeds, (n_frames,) deg/s, of minimum-jerk moves of 80 to 250 ms while it talks."""
    speeds = np.zeros(len(talks))
    widest_deg, place_deg, at = rng.uniform(0.3, 1.0) * _WIDEST_DEG, 0.0, 0
    while at < len(talks):
        length = int(rng.uniform(0.08, 0.25) * FRAMES_PER_S)
        target_deg = rng.uniform(-widest_deg, widest_deg) if talks[at] else 0.0
        phase = (np.arange(length) + 0.5) / length
        # The speed of a minimum-jerk move (Flash and Hogan 1985): 30 s^2 (1 - s)^2 a unit of time.
        course = 30.0 * phase**2 * (1.0 - phase) ** 2 * (target_deg - place_deg)
        part = course[: len(talks) - at] * FRAMES_PER_S / length
        speeds[at : at + len(part)] = part
        place_deg, at = target_deg, at + length
    return speeds


def _servo(build: np.random.Generator, rng: np.random.Generator, speed_deg_s: Array) -> Array:
    """Return the noise of one servo, (n,), from its speed at each sample, (n,) deg/s.

    build: draws gears and brushes, the same for the same robot. rng: draws the noise.
    """
    motor_hz = speed_deg_s / 360.0 * build.uniform(*_RATIO)
    turns = np.cumsum(motor_hz) / SAMPLE_RATE_HZ
    tones = np.zeros(len(speed_deg_s))
    stages = [float(build.choice(_TEETH))]
    for _ in range(3):
        stages.append(stages[-1] / build.uniform(2.5, 4.0))
    for meshes in stages:
        for k in (1, 2, 3):
            # What would alias is not there.
            heard = np.clip((7_600.0 - k * meshes * motor_hz) / 800.0, 0.0, 1.0)
            phase = 2 * np.pi * k * meshes * turns + build.uniform(0.0, 6.3)
            tones += build.uniform(0.2, 1.0) / k * heard * np.sin(phase)
    rush = lfilter([1.0, -0.7], [1.0, -0.3], rng.standard_normal(len(speed_deg_s)))
    brushes = build.uniform(0.2, 0.8) * rush * (1.0 + 0.5 * np.sin(2 * np.pi * 6 * turns))
    # Louder with speed, by 3 to 5 dB each time it doubles.
    loudness = (speed_deg_s / 100.0) ** build.uniform(0.5, 0.85)
    return np.asarray(loudness * (tones + brushes))


def _shell(build: np.random.Generator, sound: Array) -> Array:
    """A resonance of the head."""
    centre_hz, width_hz = (
        np.exp(build.uniform(np.log(300.0), np.log(5000.0))),
        build.uniform(80, 400),
    )
    radius = np.exp(-np.pi * width_hz / SAMPLE_RATE_HZ)
    poles = [1.0, -2.0 * radius * np.cos(2 * np.pi * centre_hz / SAMPLE_RATE_HZ), radius**2]
    return np.asarray(sound + 3.0 * lfilter([1.0 - radius], poles, sound))


KINDS = ("white", "music", "babble", "servos", "level", "telephone", "clipped", "room")
#: Those that are made of the speech alone; a number after the colon is a level, metres, or nothing.
_OPTIONAL_DB = ("telephone", "clipped", "room")


class ConditionError(UserError):
    """A condition that is not known; the message is one line."""


@dataclass(frozen=True, slots=True)
class Condition:
    """How speech is changed. db: signal to noise; of `level` its change; of `room` metres, or 0.

    robot: whose servos are heard. tells_servos: the recogniser gets their speeds.
    """

    kind: str
    db: float
    robot: int = 0
    tells_servos: bool = False

    def apply(self, samples: Array32, name: str, voices: list[Array32]) -> Array32:
        """Return the samples in this condition; the utterance's name chooses the random numbers.

        Parameters
        ----------
        samples : Array32
            (n,).
        name : str
            Of the utterance.
        voices : list[Array32]
            Other recordings, for babble.

        Returns
        -------
        Array32
            (n,).
        """
        rng = _rng(name)
        if self.kind == "level":
            return samples * np.float32(10.0 ** (self.db / 20.0))
        if self.kind == "telephone":
            return noise.telephone(samples)
        if self.kind == "room":
            return in_room_from(rng, samples, self.db) if self.db else in_room(rng, samples)
        if self.kind == "clipped":
            # Ten times over full scale (design measurement).
            gain = np.float32(10.0 / max(np.abs(samples).max(), 1e-9))
            clipped: Array32 = np.clip(samples * gain, -1.0, 1.0)
            return clipped
        if self.kind == "servos":
            return noise.add_noise(samples, servo_noise(rng, len(samples), self.robot)[0], self.db)
        maker = {"white": noise.white, "music": noise.band, "babble": noise.babble(voices)}
        return noise.add_noise(samples, maker[self.kind](rng, len(samples)), self.db)

    def servo_positions_deg(self, name: str, n_samples: int) -> Array | None:
        """Return encoder readings, a row each 10 ms.

        Parameters
        ----------
        name : str
            Of the utterance.
        n_samples : int
            Of it.

        Returns
        -------
        Array | None
            (n_frames, n_servos) degrees; None: the recogniser gets none.
        """
        if not self.tells_servos:
            return None
        return encoder_readings_deg(servo_noise(_rng(name), n_samples, self.robot)[1])


def parse_condition(text: str, *, tells_servos: bool = False) -> Condition:
    """Parse a condition: `KIND:DB`, as `white:10`, or `servos:DB:ROBOT`.

    tells_servos: as in `Condition`. Raises ConditionError for another form, and for `tells_servos`
    without the noise of servos.
    """
    if tells_servos and not text.startswith("servos:"):
        raise ConditionError("--servo-speeds is for the noise of servos; give --noise servos:10")
    kind, _, db = text.partition(":")
    db, _, robot = db.partition(":") if kind == "servos" else (db, "", "")
    try:
        level_db = 0.0 if not db and kind in _OPTIONAL_DB else float(db)
        return Condition(_known(kind), level_db, _number(robot or "0"), tells_servos)
    except ValueError as error:
        raise ConditionError(
            f"--noise {text!r} is not KIND:DB; kinds: {', '.join(KINDS)}; for example white:10"
        ) from error


def _rng(name: str) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(name.encode()))


def _number(text: str) -> int:
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)


def _known(kind: str) -> str:
    if kind not in KINDS:
        raise ValueError(kind)
    return kind
