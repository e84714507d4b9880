"""Speech, tones and noise for the tests of sound and recognition."""

from importlib import resources
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray

from lipsync.phonemes import SILENCE, VISEME_OF, PhonemeEvent

CLIP_PATH = Path(str(resources.files("lipservo.clips") / "welcome.flac"))
#: The clip's phones as flite says that it spoke them: `flite -psdur`, ax written as AH.
CLIP_LABELS_PATH = Path(str(resources.files("lipservo_lab.bench.sync") / "welcome.TextGrid"))
TONE_HZ = 440.0


def tone(rate_hz: int, duration_s: float = 0.5) -> NDArray[np.float64]:
    """A sine of `TONE_HZ` at half of full scale."""
    n_samples = round(duration_s * rate_hz)
    return 0.5 * np.sin(2 * np.pi * TONE_HZ * np.arange(n_samples) / rate_hz)


def clip_start(folder: Path, duration_s: float = 1.5) -> Path:
    """A file of the first seconds of the clip."""
    samples, rate_hz = soundfile.read(CLIP_PATH)
    soundfile.write(folder / "start.wav", samples[: round(duration_s * rate_hz)], rate_hz)
    return folder / "start.wav"


def cut_short(path: Path, share: float) -> None:
    """Leave only this share of a file's bytes."""
    whole = path.read_bytes()
    path.write_bytes(whole[: round(len(whole) * share)])


def white_noise(duration_s: float, level_db: float) -> NDArray[np.float64]:
    noise = np.random.default_rng(1).standard_normal(round(duration_s * 16_000))
    return noise * 10 ** (level_db / 20)


def phoneme_frames(events: tuple[PhonemeEvent, ...], n_frames: int) -> list[str]:
    """The phoneme of each 10 ms frame; silence where no event is."""
    frames = [SILENCE] * n_frames
    for event in events:
        first = round(event.start_s * 100)
        end = n_frames if event.end_s is None else min(n_frames, round(event.end_s * 100))
        frames[first:end] = [event.phoneme] * (end - first)
    return frames


def viseme_accuracy(heard: list[str], truth: list[str]) -> float:
    """The share of frames whose viseme class is right."""
    pairs = zip(heard, truth, strict=True)
    return float(np.mean([VISEME_OF[h] == VISEME_OF[t] for h, t in pairs]))
