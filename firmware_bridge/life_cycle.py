"""STAND-IN, for tests of the processes until the real one is merged: take the other version."""

import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import FrameType
from typing import Any, Self

from firmware_bridge.bridge import Bridge
from firmware_bridge.clock import Clock, ticks
from firmware_bridge.control_socket import ControlSocket, StopLevel
from firmware_bridge.lifeline import Lifeline


@dataclass(frozen=True, slots=True)
class StopReport:
    """Stand-in."""

    confirmed: tuple[str, ...]
    unconfirmed: Mapping[str, str]
    at_rest: bool

    def as_dict(self) -> dict[str, Any]:
        """Stand-in."""
        return {"confirmed": list(self.confirmed), "unconfirmed": dict(self.unconfirmed)}

    def text(self) -> str:
        """Stand-in."""
        return f"torque off confirmed by all {len(self.confirmed)} servos"


class LifeCycle:
    """Stand-in."""

    def __init__(
        self,
        bridge: Bridge,
        clock: Clock,
        *,
        rate_hz: float,
        control: ControlSocket | None = None,
        lifeline: Lifeline | None = None,
        log: Callable[[str], None] = lambda _line: None,
        status: Callable[[], Mapping[str, object]] = dict,
        stopped: StopLevel | None = None,
    ) -> None:
        self._bridge, self._clock, self._rate_hz = bridge, clock, rate_hz
        self._control, self._lifeline, self._log = control, lifeline, log
        self._status = status
        self._stopped = stopped
        self._n_signals = 0
        self.report: StopReport | None = None

    def __enter__(self) -> Self:
        def note(_number: int, _frame: FrameType | None) -> None:
            self._n_signals += 1

        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            signal.signal(number, note)
        return self

    def __exit__(self, *exc: object) -> None:
        self._bridge.stop()
        names = tuple(joint.name for joint in self._bridge._joints)
        self.report = StopReport(names, {}, True)
        if self._control is not None:
            self._control.report_end(self.report.as_dict())
        self._log(self.report.text())

    def start(self) -> None:
        """Stand-in."""
        if self._stopped is None:
            self._bridge.arm()

    def ticks(self) -> Iterator[tuple[float, int]]:
        """Stand-in."""
        level = None
        for time_s, late in ticks(self._clock, self._rate_hz):
            if self._lifeline is not None:
                self._lifeline.beat()
            if self._control is not None:
                level = self._control.poll(self._status) or level
            if self._n_signals:
                level = StopLevel.SOFT if self._n_signals == 1 else StopLevel.LIMP
            if level is not None and self._lifeline is not None:
                self._lifeline.stopped(level)
            if level is StopLevel.FREEZE:
                self._bridge.freeze()
                self._stopped = level
                level = None
            if level is StopLevel.SOFT and self._stopped is None:
                self._bridge.ease_to_neutral(self._clock)
            if level is not None:
                return
            if self._stopped is not None:
                time.sleep(0.01)
                continue
            yield time_s, late
