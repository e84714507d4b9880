"""The sound of a robot's own servos, and how fast each turned while it was made.

The motion is that of a mouth: every joint goes from place to place along minimum-jerk courses,
some five a second while the robot talks, and stands still in between. What is heard of a servo is
made from its speed alone: the mesh of each pair of gears as a tone whose height is the speed, the
brushes as a rush that the motor's turning modulates, the load as a growl, all through the shell of
a head. So the same speed always sounds much the same, as it does with real gears.

Made otherwise than the servos that training hears (training/nonspeech_sounds.py), in motion, gears
and shell, so that no network was trained on its like.
"""

import numpy as np
from scipy.signal import lfilter

from lipservo_lab.learning.recognition.noise import unit_power
from lipsync.arrays import Array, Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.recognition.features import FRAMES_PER_S

_N_SERVOS = 8
#: A joint of the mouth seldom turns faster (docs/benchmarks.md, the fastest lip apart).
_WIDEST_DEG = 14.0
#: Turns of the motor for one of the horn, and teeth that mesh a turn of the motor: XL330 and its
#: like have ratios of 250 to 350.
_RATIO, _TEETH = (250.0, 350.0), (9, 12, 14)
_HOP = SAMPLE_RATE_HZ // FRAMES_PER_S


def servo_noise(rng: np.random.Generator, n: int, robot: int = 0) -> tuple[Array32, Array]:
    """Samples (n,) of unit power; speeds (n // 160, 8) of the joints, a row each 10 ms, in deg/s.

    robot: its number; servos and shell are drawn from it, and the motion from `rng`.
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
    """Where encoders of 4096 steps see the joints at the end of each 10 ms; as the speeds."""
    step_deg = 360.0 / 4096
    places_deg = np.cumsum(speeds_deg_s, axis=0) / FRAMES_PER_S
    return np.asarray(np.rint(places_deg / step_deg) * step_deg)


def _talks(rng: np.random.Generator, n_frames: int) -> Array:
    """(n_frames,): 1 while the robot talks, 0 in its pauses."""
    talks = np.zeros(n_frames)
    at, is_talking = 0, bool(rng.random() < 0.5)
    while at < n_frames:
        length = int(rng.uniform(*((0.8, 3.0) if is_talking else (0.3, 1.2))) * FRAMES_PER_S)
        talks[at : at + length] = is_talking
        at, is_talking = at + length, not is_talking
    return talks


def _speeds_deg_s(rng: np.random.Generator, talks: Array) -> Array:
    """(n_frames,): minimum-jerk moves of 80 to 250 ms from target to target while it talks."""
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
    """One servo by its speed (n,)."""
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
