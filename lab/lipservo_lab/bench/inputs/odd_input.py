"""An odd input and what is right about it, known by who made it and never by the reader."""

import math
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Final, Literal

import numpy as np

from lipsync.errors import UserError

#: The right answer is a refusal in one line.
REFUSED: Final = "refused"
#: A reader that takes longer hangs.
LONGEST_S: Final = 20.0

Verdict = Literal["right", "traceback", "hang", "silently_wrong", "refused_wrongly"]


@dataclass(frozen=True, slots=True)
class OddInput:
    """An input with the right result of reading it, known by how the input was made.

    about: describes the input in reports. read: lets a reader read it; returns the value, and the
    lines that the reader shows to a person. right: the right value, or `REFUSED`. reported: a line
    is needed, too. may_refuse: a refusal is right as well. tolerance: for numbers.
    """

    about: str
    read: Callable[[], tuple[object, Sequence[str]]]
    right: object
    reported: bool = False
    may_refuse: bool = False
    tolerance: float = 1e-6


#: Makes an input of its kind in an empty folder.
Maker = Callable[[np.random.Generator, Path], OddInput]


class _HangError(Exception):
    """A reader that does not come back."""


def verdict(odd: OddInput) -> tuple[Verdict, str]:
    """Let a reader read an input; return the verdict, and why it is wrong (empty: it is right).

    A UserError must be one line of at most 1000 characters, else it counts as a traceback. Where
    refusing is allowed, a wrong value counts as right if the reader has reported a problem.
    """
    try:
        with _time_limit():
            value, lines = odd.read()
    except UserError as error:
        if "\n" in str(error).strip() or len(str(error)) > 1000:
            return "traceback", f"{odd.about}: no single line: {str(error)[:200]!r}"
        if odd.right == REFUSED or odd.may_refuse:
            return "right", ""
        return "refused_wrongly", f"{odd.about}: {error}"
    except _HangError:
        return "hang", odd.about
    except Exception as error:  # of whatever kind: that is what is counted
        return "traceback", f"{odd.about}: {type(error).__name__}: {error}"
    if odd.right == REFUSED:
        is_reported = odd.may_refuse and lines
        return (
            ("right", "") if is_reported else ("silently_wrong", f"{odd.about}: read as {value!r}")
        )
    if not _alike(value, odd.right, odd.tolerance) and not (odd.may_refuse and lines):
        return "silently_wrong", f"{odd.about}: {value!r} for {odd.right!r}"
    if odd.reported and not lines:
        return "silently_wrong", f"{odd.about}: nothing is reported"
    return "right", ""


def _alike(value: object, right: object, tolerance: float) -> bool:
    """Return whether two values are equal, nested ones item by item, floats within `tolerance`.

    NaN equals NaN. Keys of dicts must have the same order; a list equals a tuple.
    """
    if isinstance(right, float) and isinstance(value, int | float):
        return math.isclose(value, right, abs_tol=tolerance) or (value != value and right != right)
    if isinstance(right, dict) and isinstance(value, dict):
        return list(value) == list(right) and all(
            _alike(value[key], each, tolerance) for key, each in right.items()
        )
    if isinstance(right, list | tuple) and isinstance(value, list | tuple):
        return len(value) == len(right) and all(
            _alike(one, other, tolerance) for one, other in zip(value, right, strict=True)
        )
    return value == right


@contextmanager
def _time_limit() -> Iterator[None]:
    """Raise `_HangError` once the body has run for `LONGEST_S`; main thread only (SIGALRM)."""

    def raise_hang(_signal: int, _frame: FrameType | None) -> None:
        raise _HangError

    previous = signal.signal(signal.SIGALRM, raise_hang)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)
