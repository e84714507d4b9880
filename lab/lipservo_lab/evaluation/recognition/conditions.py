"""What the benchmark does to speech before it is recognised: noise, rooms, lines, other levels.

Rooms: the image method of Allen and Berkley (1979). Each of six walls is a mirror that absorbs a
part of the sound; the microphone gets the talker and all mirror images of the talker, each as late
and as faint as it is far. Training draws rooms of other sizes, with images for 50 ms only
(noise.py).

Servos: the sound of a robot's own servos, and how fast each turned. The motion is that of a mouth:
every joint moves along minimum-jerk courses, about five a second while the robot talks, and stands
still in between. The sound of a servo is made from its speed alone: the mesh of each pair of gears
as a tone whose frequency is in proportion to the speed, the brushes as noise modulated by the
motor's turning, all through the resonances of a head. So the same speed always sounds much the
same, as it does with real gears. Motion, gears and shell are made in another way than for training
(nonspeech_sounds.py), so that no network was trained on anything like it.
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

#: An office: length, width and height, and the share of the sound pressure that each wall reflects.
#: Its sound falls by 60 dB in half a second.
_SIZE_M, _WALLS_KEEP = np.array([5.2, 4.1, 2.7]), 0.85
_LONGEST_S = 0.6
#: Range of the microphone's place; distance of the talker from it; least distance of the talker
#: from a wall.
_LOW_M, _HIGH_M, _AWAY_M, _FROM_WALLS_M = (1.0, 1.0, 1.0), (4.2, 3.1, 1.6), (0.7, 1.8), 0.5
#: Places that are tried for a talker at the wanted distance within the walls.
_N_PLACES = 50


def in_room(rng: np.random.Generator, speech: Array32) -> Array32:
    """Return speech as a microphone somewhere in the office gets it.

    Delay and level are relative to the strongest path from the talker.

    Parameters
    ----------
    rng : np.random.Generator
        Draws where the microphone and the talker are.
    speech : Array32
        (n,) at 16 kHz.

    Returns
    -------
    Array32
        (n,).
    """
    microphone_m = rng.uniform(_LOW_M, _HIGH_M)
    direction = rng.normal(size=3) * [1.0, 1.0, 0.2]
    talker_m = microphone_m + rng.uniform(*_AWAY_M) * direction / np.linalg.norm(direction)
    talker_m = np.clip(talker_m, _FROM_WALLS_M, _SIZE_M - _FROM_WALLS_M)
    response = impulse_response(talker_m, microphone_m)
    return _convolved(response, int(response.argmax()), speech)


def in_room_from(rng: np.random.Generator, speech: Array32, away_m: float) -> Array32:
    """Return speech from a talker at a distance from a microphone in the office.

    The distance is `away_m` within 15 %, if a place for it is found. Delay and level are relative
    to the direct sound, the first that arrives.
    """
    microphone_m = rng.uniform(_LOW_M, _HIGH_M)
    for _ in range(_N_PLACES):
        direction = rng.normal(size=3) * [1.0, 1.0, 0.2]
        talker_m = microphone_m + away_m * direction / np.linalg.norm(direction)
        talker_m = np.clip(talker_m, _FROM_WALLS_M, _SIZE_M - _FROM_WALLS_M)
        if abs(np.linalg.norm(talker_m - microphone_m) - away_m) < 0.15 * away_m:
            break
    response = impulse_response(talker_m, microphone_m)
    return _convolved(response, int(np.flatnonzero(response)[0]), speech)


def _convolved(response: Array, direct: int, speech: Array32) -> Array32:
    """Return speech, (n,), convolved with a room's impulse response.

    direct: index of the sample in `response` that becomes 1 at delay 0.
    """
    n_fft = 1 << (len(speech) + len(response)).bit_length()
    spectrum = np.fft.rfft(speech, n_fft) * np.fft.rfft(response[direct:] / response[direct], n_fft)
    return np.fft.irfft(spectrum, n_fft)[: len(speech)].astype(np.float32)


def impulse_response(spoken_m: Array, heard_m: Array) -> Array:
    """Return what the microphone gets of one click, until 0.6 s after it.

    Parameters
    ----------
    spoken_m, heard_m : Array
        (3,): places of the talker and the microphone.

    Returns
    -------
    Array
        (n,) samples at 16 kHz.
    """
    distance_m, n_walls = noise.images(_SIZE_M, spoken_m, heard_m, _LONGEST_S)
    level = _WALLS_KEEP**n_walls / distance_m
    delays = np.rint(distance_m / noise.SOUND_M_S * SAMPLE_RATE_HZ).astype(np.int64)
    is_early = delays < round(_LONGEST_S * SAMPLE_RATE_HZ)
    return np.asarray(np.bincount(delays[is_early], weights=level[is_early]), dtype=np.float64)


_N_SERVOS = 8
#: A joint of the mouth seldom turns faster (docs/benchmarks.md, the fastest lip apart).
_WIDEST_DEG = 14.0
#: Gear ratios of XL330 and similar servos are 250 to 350; teeth of the motor's gear, which mesh at
#: each of its turns.
_RATIO, _TEETH = (250.0, 350.0), (9, 12, 14)
_HOP = SAMPLE_RATE_HZ // FRAMES_PER_S


def servo_noise(rng: np.random.Generator, n: int, robot: int = 0) -> tuple[Array32, Array]:
    """Return the noise of a robot's servos, and their speeds.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the motion.
    n : int
        Number of samples.
    robot : int
        Number of the robot; its servos and shell are drawn from it.

    Returns
    -------
    tuple[Array32, Array]
        (n,) samples of unit power; speeds (n // 160, 8) in deg/s, a row every 10 ms.
    """
    build = np.random.default_rng(robot)
    n_frames = n // _HOP
    talks = _talking(rng, n_frames)
    speeds = np.stack([_speeds_deg_s(rng, talks) for _ in range(_N_SERVOS)], axis=1)
    sound = np.zeros(n)
    frames = np.arange(n) / _HOP
    for joint in range(_N_SERVOS):
        speed = np.abs(np.interp(frames, np.arange(n_frames) + 0.5, speeds[:, joint]))
        sound += build.uniform(0.4, 1.2) * _servo_sound(build, rng, speed)
    for _ in range(3):
        sound = _head_resonance(build, sound)
    hiss = 0.01 * np.std(sound) * rng.standard_normal(n)
    return unit_power(sound + hiss), speeds


def encoder_readings_deg(speeds_deg_s: Array) -> Array:
    """Return the positions that XL330 encoders report at the end of each 10 ms.

    Parameters
    ----------
    speeds_deg_s : Array
        (n_frames, n_servos).

    Returns
    -------
    Array
        (n_frames, n_servos) degrees from the start, rounded to the encoder's steps.
    """
    step_deg = 1.0 / servo_models()["XL330-M288"].pulses_per_deg
    positions_deg = np.cumsum(speeds_deg_s, axis=0) / FRAMES_PER_S
    return np.asarray(np.rint(positions_deg / step_deg) * step_deg)


def _talking(rng: np.random.Generator, n_frames: int) -> Array:
    """Draw when the robot talks, (n_frames,): 1 while it talks, 0 in its pauses."""
    talks = np.zeros(n_frames)
    start, is_talking = 0, bool(rng.random() < 0.5)
    while start < n_frames:
        length = int(rng.uniform(*((0.8, 3.0) if is_talking else (0.3, 1.2))) * FRAMES_PER_S)
        talks[start : start + length] = is_talking
        start, is_talking = start + length, not is_talking
    return talks


def _speeds_deg_s(rng: np.random.Generator, talks: Array) -> Array:
    """Return a joint's speed, (n_frames,) deg/s, in minimum-jerk moves of 80 to 250 ms.

    talks: (n_frames,), 1 while the robot talks; otherwise the joint goes to 0 degrees.
    """
    speeds = np.zeros(len(talks))
    widest_deg, position_deg, start = rng.uniform(0.3, 1.0) * _WIDEST_DEG, 0.0, 0
    while start < len(talks):
        length = int(rng.uniform(0.08, 0.25) * FRAMES_PER_S)
        target_deg = rng.uniform(-widest_deg, widest_deg) if talks[start] else 0.0
        phase = (np.arange(length) + 0.5) / length
        # Speed of a minimum-jerk move (Flash and Hogan 1985): 30 s^2 (1 - s)^2 times its length,
        # with the share of time s from 0 to 1.
        course = 30.0 * phase**2 * (1.0 - phase) ** 2 * (target_deg - position_deg)
        move_deg_s = course[: len(talks) - start] * FRAMES_PER_S / length
        speeds[start : start + len(move_deg_s)] = move_deg_s
        position_deg, start = target_deg, start + length
    return speeds


def _servo_sound(build: np.random.Generator, rng: np.random.Generator, speed_deg_s: Array) -> Array:
    """Return the noise of one servo, (n,), from its speed at each sample, (n,) deg/s.

    build: draws gears and brushes, the same for the same robot. rng: draws the noise.
    """
    motor_hz = speed_deg_s / 360.0 * build.uniform(*_RATIO)
    motor_turns = np.cumsum(motor_hz) / SAMPLE_RATE_HZ
    tones = np.zeros(len(speed_deg_s))
    stages = [float(build.choice(_TEETH))]
    for _ in range(3):
        stages.append(stages[-1] / build.uniform(2.5, 4.0))
    for meshes in stages:
        for k in (1, 2, 3):
            # Fades out near 7.6 kHz: higher tones would alias.
            unaliased = np.clip((7_600.0 - k * meshes * motor_hz) / 800.0, 0.0, 1.0)
            phase = 2 * np.pi * k * meshes * motor_turns + build.uniform(0.0, 6.3)
            tones += build.uniform(0.2, 1.0) / k * unaliased * np.sin(phase)
    hiss = lfilter([1.0, -0.7], [1.0, -0.3], rng.standard_normal(len(speed_deg_s)))
    brushes = build.uniform(0.2, 0.8) * hiss * (1.0 + 0.5 * np.sin(2 * np.pi * 6 * motor_turns))
    # Louder with speed, by 3 to 5 dB each time it doubles.
    loudness = (speed_deg_s / 100.0) ** build.uniform(0.5, 0.85)
    return np.asarray(loudness * (tones + brushes))


def _head_resonance(build: np.random.Generator, sound: Array) -> Array:
    """Return the sound with one resonance of the head added; `build` draws it."""
    centre_hz, width_hz = (
        np.exp(build.uniform(np.log(300.0), np.log(5000.0))),
        build.uniform(80, 400),
    )
    radius = np.exp(-np.pi * width_hz / SAMPLE_RATE_HZ)
    poles = [1.0, -2.0 * radius * np.cos(2 * np.pi * centre_hz / SAMPLE_RATE_HZ), radius**2]
    return np.asarray(sound + 3.0 * lfilter([1.0 - radius], poles, sound))


KINDS = ("white", "music", "babble", "servos", "level", "telephone", "clipped", "room")
#: Kinds that need no number after the colon; otherwise it is a level in dB, or metres for a room.
_OPTIONAL_DB = ("telephone", "clipped", "room")


class ConditionError(UserError):
    """A condition that is not known; the message is one line."""


@dataclass(frozen=True, slots=True)
class Condition:
    """How speech is changed.

    db: signal-to-noise ratio; for `level` the change of level; for `room` metres to the talker, 0:
    any. robot: number of the robot whose servos make the noise. tells_servos: whether the
    recogniser gets their positions.
    """

    kind: str
    db: float
    robot: int = 0
    tells_servos: bool = False

    def apply(self, samples: Array32, name: str, voices: list[Array32]) -> Array32:
        """Return the samples in this condition.

        Parameters
        ----------
        samples : Array32
            (n,) at 16 kHz.
        name : str
            Name of the utterance; it determines the random numbers.
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
        """Return the encoder readings that belong to the noise of servos, a row every 10 ms.

        Parameters
        ----------
        name : str
            Name of the utterance.
        n_samples : int
            Its length.

        Returns
        -------
        Array | None
            (n_frames, n_servos) degrees; None if the recogniser gets none.
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
    """Return a generator whose random numbers are determined by the name."""
    return np.random.default_rng(zlib.crc32(name.encode()))


def _number(text: str) -> int:
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)


def _known(kind: str) -> str:
    if kind not in KINDS:
        raise ValueError(kind)
    return kind
