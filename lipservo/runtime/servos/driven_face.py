"""The servos of one face as this process drives them: bus, bridge, control socket, life cycle.

Every command that moves servos uses this module, and so does the bridge process of a daemon.
"""

import logging
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from firmware_bridge.bus import ServoBus
from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.life_cycle import Heartbeat, LifeCycle, LifeCycleLinks
from firmware_bridge.loop.targets import TargetChannel
from firmware_bridge.process.commands import CommandQueue
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.logs import face_logs
from firmware_bridge.process.port_guard import port_guard
from firmware_bridge.process.runtime_folder import socket_path
from firmware_bridge.stopping import StopRequest
from lipservo.health.health_log import health_log
from lipservo.runtime.servos.assembly import bridge_for, bus_for
from lipservo.runtime.status.face_status import whole_status
from lipservo.settings.settings import FaceSettings

_LOG: Final = logging.getLogger(__name__)


def _status_without_speech(bridge: Mapping[str, object]) -> dict[str, object]:
    """Return the status for JSON of a face without speech, given the bridge's status."""
    return whole_status(bridge, None).as_dict()


@dataclass(frozen=True, slots=True)
class ControlOptions:
    """The options of the control socket through which other programs command a face.

    path: of the socket; None: in the runtime folder. commands: handles its requests. describe:
    makes the face's status, for JSON, from the bridge's. about: fields that every answer contains
    besides the face's name and port. watched_fd: descriptor of the shared memory that clients may
    watch; None: there is none. waits: after a stop the process waits, limp, for a start; otherwise
    it ends.
    """

    path: Path | None = None
    commands: CommandQueue = field(default_factory=CommandQueue)
    describe: Callable[[Mapping[str, object]], Mapping[str, object]] = _status_without_speech
    about: Mapping[str, object] = field(default_factory=dict)
    watched_fd: int | None = None
    waits: bool = False


@dataclass(frozen=True, slots=True)
class Supervised:
    """The state that a supervisor hands to the process that drives its servos.

    lifeline: the connection to the supervisor. control_fd: descriptor of the face's listening
    control socket. stopped: a person's stop that was in force when the previous bridge process
    died. given_up: reasons for servos that stay limp, by index. switched_off: indices of servos
    that a person switched off. not_kept: returns why a stop cannot be kept beyond the supervisor,
    in one line; empty: it can.
    """

    lifeline: Heartbeat
    control_fd: int
    stopped: StopRequest | None
    given_up: Mapping[int, str]
    switched_off: Collection[int]
    not_kept: Callable[[], str] = str


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """The options with which a face's servos are driven.

    rate_hz: ticks a second; None: the face's. dry_run: servos are read and never moved. quiet: only
    errors are logged. supervised: None: there is no supervisor, and this process keeps its own log;
    under a supervisor servos may be missing.
    """

    rate_hz: float | None = None
    dry_run: bool = False
    quiet: bool = False
    control: ControlOptions = field(default_factory=ControlOptions)
    supervised: Supervised | None = None


@dataclass(frozen=True, slots=True)
class DrivenFace:
    """An open bus with its bridge and life cycle; servos are limp until `life.start`."""

    bus: ServoBus
    bridge: Bridge
    life: LifeCycle


@contextmanager
def driven_face(
    settings: FaceSettings,
    clock: Clock,
    channel: TargetChannel,
    options: DriveOptions | None = None,
    bus: ServoBus | None = None,
) -> Iterator[DrivenFace]:
    """Open the bus and the control socket, yield the driven face, and switch torque off at the end.

    channel: holds the servo targets, read in each tick. options: None: the defaults. bus: not yet
    entered; None: the face's own. Raises what the bus raises, and ControlError where no control
    socket can be made.
    """
    how = options or DriveOptions()
    supervised = how.supervised
    if bus is None:
        bus = bus_for(settings, clock, strict=supervised is None)
    bridge = bridge_for(
        settings,
        bus,
        channel,
        rate_hz=how.rate_hz,
        tolerant=supervised is not None,
        dry_run=how.dry_run,
        given_up=None if supervised is None else supervised.given_up,
        switched_off=() if supervised is None else supervised.switched_off,
    )
    with ExitStack() as stack:
        if supervised is None and not how.dry_run:
            stack.enter_context(guarded(settings))
        stack.enter_context(bus)
        life = face_life(settings.name, settings.servo_port, bridge, clock, how)
        yield DrivenFace(bus, bridge, stack.enter_context(life))


@contextmanager
def guarded(settings: FaceSettings) -> Iterator[list[int]]:
    """Start a guard process at each port of a face; it switches torque off once the face is dead.

    Yields the descriptors that each process of the face must keep open: by these a guard notices
    that all of them have ended.
    """
    with ExitStack() as stack:
        kept_open = []
        # `alone` has each bus as a face of its own.
        for one in settings.alone.values():
            if one.servo_port is not None:
                names = {joint.servo_id: joint.name for joint in one.joints()}
                guard = port_guard(settings.name, one.bus, names)
                kept_open.append(stack.enter_context(guard))
        yield kept_open


@contextmanager
def face_life(
    name: str, port: str | None, bridge: Bridge, clock: Clock, options: DriveOptions
) -> Iterator[LifeCycle]:
    """Yield the life cycle (start to end) of a bridge, with logs, health log and control socket.

    name: of the face. port: of its servos; None: simulated in memory. With a manual clock, as in a
    replay, there are no logs and no control socket.
    """
    if isinstance(clock, ManualClock):
        with LifeCycle(bridge, clock) as life:
            yield life
        return
    control, supervised = options.control, options.supervised
    about = {**control.about, "name": name, "port": port}
    path = control.path or socket_path(name)
    socket_parts = (about, control.commands, control.describe, control.watched_fd)
    with ExitStack() as stack:
        if supervised is None:
            stack.enter_context(face_logs(name, quiet=options.quiet))
            listener = stack.enter_context(ControlSocket(path, *socket_parts))
            for line in bridge.capabilities.warnings():
                _LOG.warning("%s", line)
        else:
            listener = ControlSocket(path, *socket_parts, supervised.control_fd)
            stack.enter_context(listener)
            words = bridge.capabilities.released_words
            for index, reason in supervised.given_up.items():
                _LOG.warning("stays %s: %s: %s", words, bridge.names[index], reason)
        health = health_log(name, port, os.environ)
        if health is not None:
            stack.enter_context(health)
        links = LifeCycleLinks(
            listener,
            None if supervised is None else supervised.lifeline,
            bridge.as_dict,
            None if health is None else health.offer,
            str if supervised is None else supervised.not_kept,
        )
        stopped = None if supervised is None else supervised.stopped
        yield stack.enter_context(
            LifeCycle(bridge, clock, links, stopped=stopped, waits=control.waits)
        )
