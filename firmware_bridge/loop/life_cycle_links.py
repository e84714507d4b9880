"""Whom the life cycle of a face listens to, and whom it tells what happens."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from firmware_bridge.health import ServoHealth
from firmware_bridge.orders import Order
from firmware_bridge.stopping import StopLevel, StopRequest


class Control(Protocol):
    """Where stops are asked for: `ControlSocket`."""

    def poll(self) -> StopRequest | None:
        """The stop that was requested, if any; answers nothing and never waits."""

    def answer(self, status: Callable[[], Mapping[str, object]]) -> None:
        """Answer what has come, after a stop was acted on; never waits."""

    def attend(self, refusal: Callable[[Order], str]) -> None:
        """Orders to single servos are obeyed from now on. refusal: why not this one."""

    def take_orders(self) -> Sequence[Order]:
        """What was ordered since the last call, oldest first; never waits."""

    def report_end(self, report: Mapping[str, object]) -> None:
        """Tell those who asked for a stop how it ended."""


class Heartbeat(Protocol):
    """What a supervisor hears: `Lifeline`."""

    def beat(self) -> None:
        """The loop is alive."""

    def stopped(self, level: StopLevel, *, ends: bool = False, requested_by: str = "") -> None:
        """A person stopped the face."""

    def started(self) -> None:
        """A person took a freeze back."""

    def failed(self, index: int, reason: str) -> None:
        """A servo was given up for good."""

    def switched(self, index: int, *, on: bool) -> None:
        """A person switched a servo off, or on again."""


def _no_log(_line: str) -> None:
    """Nobody reads it."""


def _no_record(_stop: StopRequest | None) -> None:
    """A face that ends with its stop needs none."""


@dataclass(frozen=True, slots=True)
class LifeCycleLinks:
    """All of them optional.

    status: what the control socket answers. log: one line of what happened; on_health: every 10 s;
    on_stopped: a person's stop and who requested it, for what must outlive this process, or None
    once a person has started the face again. All three must return at once.
    """

    control: Control | None = None
    lifeline: Heartbeat | None = None
    log: Callable[[str], None] = _no_log
    status: Callable[[], Mapping[str, object]] = dict
    on_health: Callable[[tuple[ServoHealth, ...]], None] | None = None
    on_stopped: Callable[[StopRequest | None], None] = _no_record
