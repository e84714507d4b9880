"""Bytes as they come from a client become samples. A message may be cut at any byte."""

import base64
import binascii
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float32]

_WIDTH: Final = {"s16le": 2, "f32le": 4}
_FULL_SCALE: Final = 32_768.0


class PcmDecoder:
    """Little-endian mono PCM: the half of a sample waits for its other half."""

    def __init__(self, sample_format: Literal["s16le", "f32le"]) -> None:
        self._format = sample_format
        self._width = _WIDTH[sample_format]
        self._rest = b""

    @property
    def n_left_bytes(self) -> int:
        """Bytes of a sample whose rest has not come."""
        return len(self._rest)

    def n_samples(self, data: bytes) -> int:
        """How many samples `decode` would give."""
        return (len(self._rest) + len(data)) // self._width

    def decode(self, data: bytes) -> Samples:
        """Samples (n,) float32 in [-1, 1]. What is no number counts as silence."""
        data = self._rest + data
        n_bytes = len(data) // self._width * self._width
        data, self._rest = data[:n_bytes], data[n_bytes:]
        if self._format == "s16le":
            return np.frombuffer(data, dtype="<i2").astype(np.float32) / np.float32(_FULL_SCALE)
        given = np.frombuffer(data, dtype="<f4").astype(np.float32)
        return np.clip(np.nan_to_num(given, nan=0.0, posinf=1.0, neginf=-1.0), -1.0, 1.0)


def decode_base64(text: str) -> bytes:
    """The bytes. Raises ValueError for what is no base64."""
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError("data: not base64") from error
