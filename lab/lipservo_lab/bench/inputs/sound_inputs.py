"""Sound files as people have them, each made of a voice-like sound that is known."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import soundfile

from lipservo_lab.bench.inputs.odd_input import REFUSED, Maker, OddInput
from lipsync.arrays import Array
from lipsync.audio.channels import MIX
from lipsync.audio.file import checked_sound, read_sound

_RATE_HZ: Final = 16_000
_BITS: Final = (16, 24, 32)
#: Of codecs that keep the shape of the wave: the name of libsndfile, and the ending.
_CODECS: Final = (
    *(("GSM610", "wav"), ("G721_32", "wav"), ("IMA_ADPCM", "wav"), ("MS_ADPCM", "wav")),
    *(("ULAW", "wav"), ("ALAW", "wav"), ("PCM_U8", "wav"), ("VORBIS", "ogg"), ("PCM_16", "flac")),
)


def _draw_voice(rng: np.random.Generator, seconds: float) -> Array:
    """Return the sum of five harmonics of a drawn pitch, (n,), like a voice, at 16 kHz."""
    time_s = np.arange(round(seconds * _RATE_HZ)) / _RATE_HZ
    pitch_hz = float(rng.uniform(90, 250))
    parts = [np.sin(2 * np.pi * pitch_hz * n * time_s) / n for n in range(1, 6)]
    return np.asarray(float(rng.uniform(0.1, 0.4)) * np.sum(parts, axis=0) / 2)


def _write(path: Path, samples: Array, subtype: str = "PCM_16", rate_hz: int = _RATE_HZ) -> Path:
    soundfile.write(path, samples, rate_hz, subtype=subtype)
    return path


def _compare(path: Path, expected: Array, channel: str = MIX) -> tuple[object, Sequence[str]]:
    """Read a sound file; return whether its samples are as `expected`, and the reader's warnings.

    expected: (n,), at 16 kHz; lengths may differ by an eighth of a second.
    """
    warnings = [line for line in [checked_sound(path, channel).warning] if line]
    samples = read_sound(path, channel)[0]
    n = min(len(samples), len(expected))
    has_length = abs(len(samples) - len(expected)) <= _RATE_HZ // 8
    return bool(has_length and np.abs(samples[:n] - expected[:n]).max() < 2e-3), warnings


def _channels_in_antiphase(rng: np.random.Generator, folder: Path) -> OddInput:
    voice = _draw_voice(rng, 0.4)
    quieter = float(rng.uniform(0.95, 1.0))
    path = _write(folder / "a.wav", np.stack([voice, -quieter * voice], axis=1))
    return OddInput("antiphase", lambda: _compare(path, voice), right=True, reported=True)


def _floats_of_whole_numbers(rng: np.random.Generator, folder: Path) -> OddInput:
    bits, voice = int(rng.choice(_BITS)), _draw_voice(rng, 0.4)
    path = _write(folder / "a.wav", voice * 2.0 ** (bits - 1), "FLOAT")
    return OddInput(f"{bits} bits", lambda: _compare(path, voice), right=True, reported=True)


def _wrong_size(rng: np.random.Generator, folder: Path) -> OddInput:
    """Write a WAV file whose header has a size of zero, or one far too large; to be read whole."""
    voice = _draw_voice(rng, 0.4)
    path = _write(folder / "a.wav", voice)
    content = bytearray(path.read_bytes())
    size = int(rng.choice([0, 0xFFFF_FFFF, 0x7FFF_F000, 0x7FFF_FFFF]))
    size_at = content.find(b"data") + 4
    content[size_at : size_at + 4] = content[4:8] = struct.pack("<I", size)
    path.write_bytes(content)
    return OddInput(f"size {size:x}", lambda: _compare(path, voice), right=True)


def _chosen_channel(rng: np.random.Generator, folder: Path) -> OddInput:
    """Write a file of one to four channels and choose one of them, or their mix.

    To be refused where the file has no such channel.
    """
    n = int(rng.integers(1, 5))
    voices = np.stack([_draw_voice(rng, 0.3) for _ in range(n)], axis=1)
    path = _write(folder / "a.wav", voices)
    channel = str(rng.choice(["left", "right", "mix", "1", "2", "3", "4", "5"]))
    if channel == MIX:
        return OddInput(f"mix of {n}", lambda: _compare(path, voices.mean(axis=1)), right=True)
    index = {"left": 1, "right": 2}.get(channel) or int(channel)
    about = f"{channel} of {n}"
    if index > n:
        return OddInput(about, lambda: _compare(path, voices[:, 0], channel), REFUSED)
    return OddInput(about, lambda: _compare(path, voices[:, index - 1], channel), right=True)


def _cut_off(rng: np.random.Generator, folder: Path) -> OddInput:
    """Cut a sound file anywhere in its middle: to be refused, or reported."""
    suffix, subtype = (("wav", "PCM_16"), ("mp3", "MPEG_LAYER_III"), ("ogg", "VORBIS"))[
        int(rng.integers(3))
    ]
    voice = _draw_voice(rng, 1.5)
    path = _write(folder / f"a.{suffix}", voice, subtype)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * rng.uniform(0.3, 0.85))])
    read: Any = lambda: _compare(path, voice)  # noqa: E731 - as all others here
    return OddInput(f"cut {suffix}", read, REFUSED, may_refuse=True)


def _broken_file(rng: np.random.Generator, folder: Path) -> OddInput:
    """Write a WAV file that is to be refused: NaN or infinity, silence, too short, random bytes."""
    path, voice = folder / "a.wav", _draw_voice(rng, 0.4)
    kind = int(rng.integers(4))
    if kind == 0:
        voice[int(rng.integers(len(voice)))] = float(rng.choice([np.nan, np.inf]))
        _write(path, voice, "FLOAT")
    elif kind == 1:
        _write(path, 0 * voice)
    elif kind == 2:
        _write(path, voice[: int(rng.integers(0, 300))])
    else:
        path.write_bytes(rng.bytes(int(rng.integers(0, 2000))))
    return OddInput(f"broken {kind}", lambda: _compare(path, voice), REFUSED)


def _encoded(rng: np.random.Generator, folder: Path) -> OddInput:
    """Write a sound with a drawn codec; read, it is to correlate by more than 0.8 with the sound.

    Where this libsndfile cannot write the codec, the file is WAV.
    """
    subtype, suffix = _CODECS[int(rng.integers(len(_CODECS)))]
    voice = _draw_voice(rng, 0.6)
    try:
        path = _write(folder / f"a.{suffix}", voice, subtype)
    except (soundfile.LibsndfileError, ValueError):  # this libsndfile cannot write it
        path = _write(folder / "a.wav", voice)

    def read() -> tuple[object, Sequence[str]]:
        samples = read_sound(path)[0]
        n = min(len(samples), len(voice))
        return bool(np.corrcoef(samples[:n], voice[:n])[0, 1] > 0.8), ()

    return OddInput(subtype, read, right=True)


SOUND_KINDS: Final[dict[str, Maker]] = {
    "sound: antiphase": _channels_in_antiphase,
    "sound: whole numbers": _floats_of_whole_numbers,
    "sound: no size": _wrong_size,
    "sound: channels": _chosen_channel,
    "sound: cut": _cut_off,
    "sound: broken": _broken_file,
    "sound: codecs": _encoded,
}
