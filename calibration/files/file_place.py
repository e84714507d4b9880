"""Reading a YAML file value by value, so that every mistake names the place where it is."""

import sys

import numpy as np

from calibration.calibration import CalibrationError
from lipsync.arrays import Array
from lipsync.errors import shown

_MAX = sys.float_info.max


class Place:
    """One value of the file and the keys that led to it.

    Every read is checked; what is wrong raises CalibrationError, which names the keys.
    """

    def __init__(self, value: object, path: str) -> None:
        self._value = value
        self.path = path

    @property
    def _where(self) -> str:
        return self.path or "the file"

    @property
    def names(self) -> tuple[str, ...]:
        """The keys below this place."""
        if not isinstance(self._value, dict) or not self._value:
            raise CalibrationError(f"{self._where} should hold `key: value` lines")
        for key in self._value:
            if not isinstance(key, str):
                raise CalibrationError(f"{self._where}: the key {shown(key)} is no text")
        return tuple(self._value)

    def at(self, key: str) -> "Place":
        """What lies under a key."""
        path = f"{self.path}.{key}" if self.path else key
        if key not in self.names or not isinstance(self._value, dict):
            raise CalibrationError(f"{path} is missing")
        return Place(self._value[key], path)

    def text(self) -> str:
        """Some text."""
        if not isinstance(self._value, str):
            raise CalibrationError(f"{self.path} is {shown(self._value)}, expected text in quotes")
        return self._value

    def number(self) -> float:
        """A finite number."""
        value = self._value
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _MAX:
            return float(value)
        raise CalibrationError(f"{self.path} is {shown(value)}, expected a finite number")

    def has(self, key: str) -> bool:
        """Whether there is such a key."""
        return key in self.names

    def count(self) -> int:
        """A whole number, not negative."""
        if isinstance(self._value, bool) or not isinstance(self._value, int) or self._value < 0:
            raise CalibrationError(
                f"{self.path} is {shown(self._value)}, expected a whole number >= 0"
            )
        return self._value

    def flag(self) -> bool:
        """True or false."""
        if not isinstance(self._value, bool):
            raise CalibrationError(f"{self.path} is {shown(self._value)}, expected true or false")
        return self._value

    def whole(self) -> int:
        """A whole number of either sign."""
        if isinstance(self._value, bool) or not isinstance(self._value, int):
            raise CalibrationError(f"{self.path} is {shown(self._value)}, expected a whole number")
        return self._value

    def places(self) -> list["Place"]:
        """What a list holds, one at least."""
        values = self._value
        if not isinstance(values, list) or not values:
            raise CalibrationError(f"{self.path} should be a list")
        return [Place(value, f"{self.path}[{i}]") for i, value in enumerate(values)]

    def numbers(self, n: int | None = None) -> Array:
        """(n,), or at least one where n is None."""
        values = self._value
        if not isinstance(values, list) or not values:
            raise CalibrationError(f"{self.path} should be a list of numbers")
        if n is not None and len(values) != n:
            raise CalibrationError(f"{self.path} holds {len(values)} numbers, expected {n}")
        return np.array([Place(v, f"{self.path}[{i}]").number() for i, v in enumerate(values)])
