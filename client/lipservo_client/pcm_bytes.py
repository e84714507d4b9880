"""Samples in whatever a program has them become bytes of PCM."""

from typing import Protocol, runtime_checkable

_FULL_SCALE = 32_767


@runtime_checkable
class SampleArray(Protocol):
    """A NumPy array, known by this; numpy is loaded only where one is written."""

    @property
    def dtype(self) -> object:
        """Its numbers' type."""

    def tobytes(self) -> bytes:
        """Its numbers."""


#: s16le bytes, or an array (n,) or (n, 1): int16, or float in [-1, 1].
Pcm = bytes | bytearray | memoryview | SampleArray


def pcm_bytes(samples: Pcm) -> bytes:
    """The samples as s16le. Raises ValueError for an array of another shape or type."""
    if isinstance(samples, (bytes, bytearray, memoryview)):
        return bytes(samples)
    import numpy as np

    array = np.asarray(samples)
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 1:
        raise ValueError(f"samples of shape {array.shape}: mono is (n,) or (n, 1)")
    if np.issubdtype(array.dtype, np.floating):
        array = np.rint(np.clip(np.nan_to_num(array), -1.0, 1.0) * _FULL_SCALE)
    elif array.dtype != np.int16:
        raise ValueError(f"samples of type {array.dtype}: int16 or float in [-1, 1] are possible")
    return bytes(array.astype("<i2").tobytes())
