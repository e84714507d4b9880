"""Sound files of the user's own that hold no speech: music, effects, the robot in its room."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lipservo_lab.learning.recognition.noise import Noise, unit_power
from lipsync.arrays import Array32
from lipsync.audio.source import SoundError
from lipsync.errors import UserError
from lipsync.recognition.speech_file import read_speech

#: Of a long file so much is kept, from its middle: memory, and no file should drown the others.
_LONGEST_S = 90
_SAMPLES_S = 16_000


class FoundSoundsError(UserError):
    """A folder of sounds cannot be used; the message is one line."""


def read_found_sounds(
    folder: Path, warn: Callable[[str], None] = lambda _line: None
) -> list[Array32]:
    """Every sound file below a folder, (n,) at 16 kHz; what is no sound is told and left out.

    Raises FoundSoundsError for a folder that holds no sound.
    """
    if not folder.is_dir():
        raise FoundSoundsError(f"{folder}: no such folder; give one of sounds without speech")
    sounds = []
    for path in sorted(folder.rglob("*")):
        if not path.is_file():
            continue
        try:
            samples = read_speech(path)
        except SoundError as error:
            warn(str(error))
            continue
        spare = max(0, len(samples) - _LONGEST_S * _SAMPLES_S) // 2
        # Float16 would do; half the memory is not worth another type.
        sounds.append(samples[spare : spare + _LONGEST_S * _SAMPLES_S].copy())
    if not sounds:
        raise FoundSoundsError(f"{folder}: holds no sound file that can be read")
    return sounds


def found(sounds: list[Array32]) -> Noise:
    """A part of one of the sounds; short ones again and again with pauses, long ones likelier."""
    weights = np.sqrt([float(len(sound)) for sound in sounds])
    chances = weights / weights.sum()

    def part(rng: np.random.Generator, n: int) -> Array32:
        sound = sounds[int(rng.choice(len(sounds), p=chances))]
        if len(sound) >= n:
            first = int(rng.integers(0, len(sound) - n + 1))
            return unit_power(sound[first : first + n])
        total = np.zeros(n, np.float32)
        at = int(rng.integers(0, max(1, n - len(sound))))
        while at < n:
            end = min(n, at + len(sound))
            total[at:end] = sound[: end - at]
            at = end + int(rng.integers(0, 2 * _SAMPLES_S))
        return unit_power(total)

    return part
