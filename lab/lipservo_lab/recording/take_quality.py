"""What is wrong with a take, as far as numbers tell; for whoever could say it again."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import SAMPLE_RATE_HZ

Samples = NDArray[np.float32]

#: A sample this large has met the end of a converter's range.
_FULL_SCALE: Final = 0.999
#: So many of them: one alone is not heard.
_FEWEST_CLIPPED: Final = 3
_WINDOW_S: Final = 0.05
#: The loudest tenth of the windows, dB below full scale; speech near a microphone is at -30 to -15.
_QUIETEST_DB: Final = -42.0
#: Speech above the quietest tenth: less is a noisy room, or nobody spoke.
_LEAST_ABOVE_NOISE_DB: Final = 12.0
#: Mean brightness of a picture, of 255, below which skin and lips look alike to a camera.
_DARKEST: Final = 50.0
#: Share of the promised pictures that must be there.
_FEWEST_FRAMES: Final = 0.9
#: Pictures this far apart hide a closure of the lips (P lasts 80 ms).
_LONGEST_GAP_S: Final = 0.1
#: Fewer pictures a second do not show how lips close.
SLOWEST_HZ: Final = 24.0
_SHORTEST_S: Final = 0.7


def sound_level_db(samples: Samples) -> float:
    """Root mean square in dB below full scale, at least -90."""
    if not len(samples):
        return -90.0
    return max(-90.0, 10.0 * float(np.log10(np.mean(np.square(samples, dtype=np.float64)) + 1e-9)))


def warnings_of(
    samples: Samples,
    frames_s: Sequence[float],
    brightness: Sequence[float],
    rate_hz: float,
    lost_blocks: int = 0,
) -> tuple[str, ...]:
    """One line for each thing that is wrong; none for a good take.

    samples: (n,) at 16 kHz; frames_s: times of the pictures; brightness: means of some of them,
    0 to 255; rate_hz: pictures a second that the camera promised; lost_blocks: blocks of 10 ms of
    sound that were lost.
    """
    duration_s = len(samples) / SAMPLE_RATE_HZ
    found = []
    if duration_s < _SHORTEST_S:
        found.append(f"only {duration_s:.1f} s long: was the whole sentence said?")
    found += _of_sound(samples)
    if lost_blocks:
        found.append(f"{10 * lost_blocks} ms of sound were lost: close other programs")
    found += _of_pictures(np.asarray(frames_s), duration_s, rate_hz)
    if len(brightness) and np.mean(brightness) < _DARKEST:
        found.append(
            f"too dark (brightness {np.mean(brightness):.0f} of 255): put a lamp before the face"
        )
    return tuple(found)


def _of_sound(samples: Samples) -> list[str]:
    n_clipped = int((np.abs(samples) >= _FULL_SCALE).sum())
    if n_clipped >= _FEWEST_CLIPPED:
        return [f"{n_clipped} samples clipped: turn the microphone down or sit farther away"]
    window = round(_WINDOW_S * SAMPLE_RATE_HZ)
    n = len(samples) // window
    if not n:
        return []
    levels = [sound_level_db(each) for each in samples[: n * window].reshape(n, window)]
    loud_db, noise_db = float(np.quantile(levels, 0.9)), float(np.quantile(levels, 0.1))
    if loud_db < _QUIETEST_DB:
        return [f"too quiet ({loud_db:.0f} dB): turn the microphone up or come nearer"]
    if loud_db - noise_db < _LEAST_ABOVE_NOISE_DB:
        return [
            f"speech is only {loud_db - noise_db:.0f} dB above the noise: was the sentence said, "
            "with a moment of silence before it?"
        ]
    return []


def _of_pictures(frames_s: NDArray[np.float64], duration_s: float, rate_hz: float) -> list[str]:
    if len(frames_s) < 2:
        return ["no pictures: does the camera work?"]
    found_hz = (len(frames_s) - 1) / float(frames_s[-1] - frames_s[0])
    gaps_s = np.diff(np.append(frames_s, max(duration_s, frames_s[-1])))
    if found_hz < max(SLOWEST_HZ - 0.5, _FEWEST_FRAMES * rate_hz):
        return [
            f"{found_hz:.1f} pictures a second, {rate_hz:.0f} were promised: more light, or a "
            "smaller picture (--size)"
        ]
    if gaps_s.max() > _LONGEST_GAP_S:
        return [f"{1e3 * gaps_s.max():.0f} ms without a picture: close other programs"]
    return []
