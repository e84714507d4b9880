"""The life cycle of one face as every command starts it."""

import logging
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.loop.bridge import Bridge, face_status
from firmware_bridge.loop.life_cycle import LifeCycle, LifeCycleLinks
from firmware_bridge.process.commands import CommandQueue
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.logs import face_logs
from firmware_bridge.process.runtime_folder import socket_path
from lipservo.health.health_log import health_log
from lipservo.runtime.status.face_status import whole_status

_LOG: Final = logging.getLogger(__name__)


def _of_the_servos(bridge: Mapping[str, object]) -> dict[str, object]:
    """The status of a face that nobody speaks through."""
    return whole_status(bridge, None).as_dict()


@dataclass(frozen=True, slots=True)
class ControlOptions:
    """How a face is commanded from outside.

    path: of its socket; None: in the runtime folder. commands: what is asked of it. describe: makes
    its status, for JSON, of what the bridge knows. about: what every answer says besides the face's
    name and port. watched_fd: of the memory that a client may watch; None: there is none. waits:
    a stop leaves a face that waits, limp, for a start; otherwise it ends.
    """

    path: Path | None = None
    commands: CommandQueue = field(default_factory=CommandQueue)
    describe: Callable[[Mapping[str, object]], Mapping[str, object]] = _of_the_servos
    about: Mapping[str, object] = field(default_factory=dict)
    watched_fd: int | None = None
    waits: bool = False


@contextmanager
def face_life(
    name: str,
    port: str | None,
    bridge: Bridge,
    clock: Clock,
    *,
    quiet: bool = False,
    control: ControlOptions | None = None,
) -> Iterator[LifeCycle]:
    """The life cycle of a face that this process drives: `lipservo stop` finds it.

    port: of its servos, None: simulated in memory. On a clock of its own it is nobody's to stop.
    Raises ControlError where no socket can be made.
    """
    if isinstance(clock, ManualClock):
        with LifeCycle(bridge, clock) as life:
            yield life
        return
    with ExitStack() as stack:
        stack.enter_context(face_logs(name, quiet=quiet))
        asked = ControlOptions() if control is None else control
        about = {**asked.about, "name": name, "port": port}
        path = asked.path or socket_path(name)
        listener = ControlSocket.bind(path, about, asked.commands, asked.describe, asked.watched_fd)
        stack.enter_context(listener)
        for line in bridge.capabilities.warnings():
            _LOG.warning("%s", line)
        healths = health_log(name, port, os.environ)
        if healths is not None:
            stack.enter_context(healths)
        links = LifeCycleLinks(
            control=listener,
            status=partial(face_status, bridge),
            on_health=None if healths is None else healths.offer,
        )
        yield stack.enter_context(LifeCycle(bridge, clock, links, waits=asked.waits))
