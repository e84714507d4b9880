"""Speech in a room with six walls: the image method of Allen and Berkley (1979).

Each wall is a mirror that takes a part of the sound; a microphone hears the talker and all mirror
images of the talker, each as late and as faint as it is far. Training knows rooms only as a tail of
noise that fades (noise.py), so that this is another room than any it has heard.
"""

import numpy as np

from lipsync.arrays import Array, Array32
from lipsync.audio_block import SAMPLE_RATE_HZ

#: An office: length, width and height, and what part of the pressure each wall gives back. Its
#: sound falls by 60 dB in half a second.
_SIZE_M, _WALLS_KEEP = np.array([5.2, 4.1, 2.7]), 0.85
_LONGEST_S, _SOUND_M_S = 0.6, 343.0
#: Where the microphone stands; how far away somebody speaks, and no nearer to a wall than so.
_LOW_M, _HIGH_M, _AWAY_M, _FROM_WALLS_M = (1.0, 1.0, 1.0), (4.2, 3.1, 1.6), (0.7, 1.8), 0.5


def in_room(rng: np.random.Generator, speech: Array32) -> Array32:
    """The same (n,) samples, heard by a microphone somewhere in the room.

    The direct sound keeps its time and its level.
    """
    heard_m = rng.uniform(_LOW_M, _HIGH_M)
    direction = rng.normal(size=3) * [1.0, 1.0, 0.2]
    spoken_m = heard_m + rng.uniform(*_AWAY_M) * direction / np.linalg.norm(direction)
    spoken_m = np.clip(spoken_m, _FROM_WALLS_M, _SIZE_M - _FROM_WALLS_M)
    response = impulse_response(spoken_m, heard_m)
    direct = int(response.argmax())
    n_fft = 1 << (len(speech) + len(response)).bit_length()
    spectrum = np.fft.rfft(speech, n_fft) * np.fft.rfft(response[direct:] / response[direct], n_fft)
    return np.fft.irfft(spectrum, n_fft)[: len(speech)].astype(np.float32)


def impulse_response(spoken_m: Array, heard_m: Array) -> Array:
    """(n,) samples: what one click at spoken_m (3,) is at heard_m (3,), until it has died away."""
    apart_m, bounces = zip(*(_images(k, spoken_m[k], heard_m[k]) for k in range(3)), strict=True)
    x_m, y_m, z_m = np.ix_(*apart_m)
    far_m = np.sqrt(x_m**2 + y_m**2 + z_m**2)
    x, y, z = np.ix_(*bounces)
    level = _WALLS_KEEP ** (x + y + z) / far_m
    at = np.rint(far_m / _SOUND_M_S * SAMPLE_RATE_HZ).astype(np.int64)
    in_time = at < round(_LONGEST_S * SAMPLE_RATE_HZ)
    return np.asarray(np.bincount(at[in_time], weights=level[in_time]), dtype=np.float64)


def _images(axis: int, spoken_m: float, heard_m: float) -> tuple[Array, Array]:
    """Along one axis: how far each image is, and off how many walls it came; (n_images,) each."""
    length_m = _SIZE_M[axis]
    most = int(np.ceil(_SOUND_M_S * _LONGEST_S / (2 * length_m)))
    rooms = np.arange(-most, most + 1)
    places_m = np.concatenate([2 * rooms * length_m + spoken_m, 2 * rooms * length_m - spoken_m])
    return places_m - heard_m, np.concatenate([np.abs(2 * rooms), np.abs(2 * rooms - 1)])
