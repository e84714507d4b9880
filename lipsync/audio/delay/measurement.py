"""Clicks are played and listened to, and the devices' time stamps compared with what was heard."""

import math
from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.delay.clicks import CLICKS_S, LATEST_S, Delay, click_train, find_delay
from lipsync.audio.source import AudioSource, Loudspeaker, SoundError

Samples = NDArray[np.float32]
Reports = NDArray[np.float64]

#: Sound is written so far ahead of what is heard.
_AHEAD_S: Final = 0.5
#: A loudspeaker that has not played it by then does not play.
_PATIENCE_S: Final = 15.0
_TICK_S: Final = 0.01
#: Time stamps within this of a click say when it left.
_NEAR_S: Final = 0.25


class Microphone(AudioSource, Protocol):
    """A source that says when its sound was captured."""

    @property
    def captured(self) -> tuple[float, float] | None:
        """(monotonic seconds, sound time captured then)."""


def measure_delay(
    speaker: Loudspeaker,
    microphone: Microphone,
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> Delay:
    """How much later than the loudspeaker says its sound is heard. Both are open; takes 7 s.

    The error of the microphone's own time stamps is in it, and the way through the air: 3 ms a
    metre. Raises SoundError where the clicks are not heard well enough, or nothing plays.
    """
    train = np.concatenate((click_train(speaker.rate_hz), np.zeros(speaker.rate_hz, np.float32)))
    begun_s = clock()
    n_written = 0
    left: list[tuple[float, float]] = []
    captured: list[tuple[float, float]] = []
    heard: list[Samples] = []
    ends_s = math.inf
    while clock() < ends_s:
        report = speaker.position()
        position_s = 0.0 if report is None else report[1]
        if report is not None:
            left.append(report)
            if position_s > CLICKS_S[-1] and ends_s == math.inf:
                ends_s = clock() + LATEST_S
        n_due = round((position_s + _AHEAD_S) * speaker.rate_hz)
        if n_due > n_written:
            speaker.write(train[n_written:n_due])
            n_written = n_due
        heard += [block.samples for block in microphone.blocks(math.inf)]
        if microphone.captured is not None:
            captured.append(microphone.captured)
        if ends_s == math.inf and clock() - begun_s > _PATIENCE_S:
            raise SoundError("the loudspeaker does not play: nothing asks for its sound")
        sleep(_TICK_S)
    if not captured:
        raise SoundError("the microphone brought no sound at all")
    expected_s = _expected_s(np.array(left), np.array(captured))
    return find_delay(np.concatenate(heard), expected_s)


def _expected_s(left: Reports, captured: Reports) -> NDArray[np.float64]:
    """The sound time of the microphone at which each click is heard if it is not late.

    By the time stamps near each click alone: while it wakes up, a device may lose sound without
    saying so (a PulseAudio monitor 0.2 s of it).
    """
    expected_s = []
    for click_s in CLICKS_S:
        leaves_s = click_s + _zero_s(left, left[:, 1] - click_s)
        expected_s.append(leaves_s - _zero_s(captured, captured[:, 0] - leaves_s))
    return np.array(expected_s)


def _zero_s(reports: Reports, distance_s: NDArray[np.float64]) -> float:
    """When time 0 was, by the reports (n, 2) of clock and position that are near, or nearest."""
    nearest_s = float(np.min(np.abs(distance_s)))
    is_near = np.abs(distance_s) <= max(_NEAR_S, nearest_s)
    return float(np.median(reports[is_near, 0] - reports[is_near, 1]))
