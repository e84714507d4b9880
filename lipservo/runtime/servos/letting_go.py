"""Stopping a face or releasing a port from outside: by a request, or by killing a hung process.

The outcome lists which servos confirmed torque off.
"""

import contextlib
import logging
import os
import signal
import socket
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

from firmware_bridge.errors import BusError
from firmware_bridge.port_names import named_ports, ports_in
from firmware_bridge.process.control_client import RunningFace, ask, send_stop, stop_and_wait
from firmware_bridge.process.port_holders import (
    end_hung,
    holders_of,
    holders_of_socket,
    is_ours,
    ports_held_by,
    supervisor_of,
    with_children,
)
from firmware_bridge.process.runtime_folder import knock
from firmware_bridge.stopping import StopLevel, named_by_reason

if TYPE_CHECKING:
    from firmware_bridge.bus_kinds import BusKind, Wiring
    from firmware_bridge.bus_settings import BusSettings
    from lipservo.settings.settings import FaceSettings

#: Easing to rest takes 2 s; a bridge that hangs meanwhile is noticed, and its servos are let go, in
#: as much again.
_END_S = 10.0
#: A port is free this long after its holder has died.
_PORT_S = 2.0
#: A process that holds a port gets so long to end by itself after a signal, before it is killed.
_POLITE_S = 2.0
_POLL_S = 0.05
_ANSWER_S = 1.0
_LOG: Final = logging.getLogger(__name__)


@dataclass(slots=True)
class Outcome:
    """The result of stopping one face or releasing one port.

    at_rest: whether the face had come to neutral before it let go; None: not known. dry_run: no
    torque was ever switched on. confirmed: servos that confirmed torque off; unconfirmed: reasons,
    by name, for those that did not. problem: empty when the request could be carried out. waits:
    the face's process lives on, limp, and can be started again. released: servos with torque off
    that cannot confirm it; released_words: their state, in words. holds, limp, unknown: of a
    freeze, the servos that hold, that are limp, and of which neither is known. not_kept: why the
    stop is forgotten when the face's processes end; empty: it is not.
    """

    name: str
    port: str | None = None
    pid: int | None = None
    at_rest: bool | None = None
    dry_run: bool = False
    confirmed: list[str] = field(default_factory=list)
    unconfirmed: dict[str, str] = field(default_factory=dict)
    problem: str = ""
    waits: bool = False
    released: list[str] = field(default_factory=list)
    released_words: str = ""
    holds: list[str] = field(default_factory=list)
    limp: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    not_kept: str = ""

    @property
    def is_confirmed(self) -> bool:
        """Whether there was no problem, and each servo confirmed, or holds as requested."""
        return not (self.problem or self.unconfirmed or self.unknown)

    def add_report(self, report: Mapping[str, Any]) -> None:
        """Add what a face has reported of its end: its rest, and which servos confirmed it."""
        self.at_rest, self.dry_run = report.get("at_rest"), bool(report.get("dry_run"))
        self.confirmed = list(report.get("confirmed", ()))
        self.unconfirmed = dict(report.get("unconfirmed", {}))
        self.waits = bool(report.get("waits"))
        self.released = list(report.get("released", ()))
        self.released_words = str(report.get("released_words", ""))

    def add_freeze(self, answer: Mapping[str, Any]) -> None:
        """Add what a face has answered to a freeze: which servos hold."""
        if "holds" not in answer:
            self.problem = f"{answer.get('error', 'accepted, but does not say what it holds')}"
            return
        self.holds, self.limp = list(answer["holds"]), list(answer["limp"])
        self.unknown = list(answer["unknown"])
        if not (self.holds or self.unknown):
            self.unconfirmed = dict.fromkeys(self.limp, "limp: nothing is held")

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name for JSON; those about released or held servos where set."""
        return {
            name: value for name, value in asdict(self).items() if value or name not in _ONLY_IF_SET
        }

    def text(self) -> str:
        """Return the outcome in one line for a person."""
        line = self._line()
        if self.not_kept:
            line += f"; the next start of its process will not know of this stop: {self.not_kept}"
        return line

    def _line(self) -> str:
        """Return name and result in one line, without `not_kept`."""
        unconfirmed = named_by_reason(self.unconfirmed)
        confirmed = f"confirmed by {len(self.confirmed)} servos"
        confirmed += f", NOT by {unconfirmed}" if unconfirmed else ""
        if self.problem and (self.confirmed or self.unconfirmed):
            return f"{self.name}: {self.problem}; else {confirmed}"
        if words := self.problem or (_DRY_RUN if self.dry_run else ""):
            return f"{self.name}: {words}"
        if self.holds or self.limp or self.unknown:
            return f"{self.name}: {self._held_words()}"
        if self.released and not self.unconfirmed:
            also = f"; confirmed by {len(self.confirmed)} servos" if self.confirmed else ""
            return f"{self.name}: {self.released_words} ({len(self.released)} servos){also}"
        if not self.unconfirmed:
            note = f", confirmed by all {len(self.confirmed)} servos" if self.confirmed else ""
            waits = "; it waits: `lipservo start`" if self.waits else ""
            return f"{self.name}: {'at rest and ' if self.at_rest else ''}limp{note}{waits}"
        return f"{self.name}: {confirmed}"

    def _held_words(self) -> str:
        """Return which servos of a frozen face hold, which are limp, and which may be either."""
        n = len(self.holds)
        parts = [f"held where it is: {'1 servo holds' if n == 1 else f'{n} servos hold'}"]
        if self.limp:
            parts.append(f"{', '.join(self.limp) if n else f'{len(self.limp)} servos'} limp")
        if self.unknown:
            parts.append(f"not known of {', '.join(self.unknown)}")
        if not self.holds:
            parts[0] = "nothing is known to be held" if self.unknown else "nothing is held"
        return "; ".join(filter(None, parts))


_DRY_RUN: Final = "dry run over; no torque was switched on"
#: Fields of an outcome that its JSON lacks where they are empty.
_ONLY_IF_SET: Final = ("released", "released_words", "holds", "limp", "unknown", "not_kept")


def stop_faces(
    faces: Sequence[RunningFace], level: StopLevel, *, end: bool = False
) -> list[Outcome]:
    """Stop faces and return the outcome of each; a hung one is killed and its port released.

    Every face is sent the stop before any answer is awaited, so that no hung face delays another.
    level: kind of stop; for FREEZE no hung face is killed. end: a daemon ends; otherwise it waits,
    limp.
    """
    sent: list[socket.socket | None] = []
    for face in faces:
        try:
            sent.append(send_stop(face.path, level, end=end))
        except OSError:
            sent.append(None)  # what is wrong is found when it is waited for
    with ThreadPoolExecutor(max(1, len(faces)), thread_name_prefix="stop") as pool:
        waiting = [
            pool.submit(_await_stop, face, level, client, end=end)
            for face, client in zip(faces, sent, strict=True)
        ]
        return [each.result() for each in waiting]


def _await_stop(
    face: RunningFace, level: StopLevel, sent: socket.socket | None, *, end: bool
) -> Outcome:
    """Stop one face, wait until its servos have confirmed, and return the outcome.

    A face that does not answer is killed. The ports of a face that ends without a report are opened
    here, and torque is switched off at them. sent: the connection by which the stop was sent; None:
    it could not be sent, and is sent here. end: the face's process ends, too.
    """
    outcome = Outcome(face.name, pid=face.pid)
    # Noted before the stop: only these ports are opened here, never one that the face names.
    held_ports = _ports_of(face)
    try:
        answer, report = stop_and_wait(face.path, level, _END_S, end=end, sent=sent)
    except TimeoutError:
        return _end_by_force(face, level, outcome)
    except PermissionError:
        outcome.problem = "we may not stop it; join the group of its socket, or use sudo"
        return outcome
    except OSError as error:
        outcome.problem = f"has gone: {error.strerror or error}; `lipservo limp --port PORT`"
        return outcome
    outcome.port = answer.get("port")
    outcome.not_kept = str((report or answer).get("not_kept", ""))
    if level is StopLevel.FREEZE:
        outcome.add_freeze(answer)
    elif report is not None:
        outcome.add_report(report)
    elif knock(face.path) == 0:
        troubles = "; ".join(_troubles_of(face))
        outcome.problem = f"will stop, but has not confirmed it within {_END_S:g} s" + (
            f": {troubles}" if troubles else ""
        )
    elif held_ports:
        _LOG.warning("%s ended unexpectedly; opening its port", face.name)
        _merge_into(outcome, _release_all(face.name, {each: each for each in held_ports}, {}))
    else:
        outcome.problem = f"ended unexpectedly; `lipservo limp --port {outcome.port or 'PORT'}`"
    return outcome


def _ports_of(face: RunningFace) -> list[str]:
    """Return the ports that the processes behind a face's socket have locked now."""
    held = [port for pid in holders_of_socket(face.path) for port in ports_held_by(pid)]
    return list(dict.fromkeys(held))


def _troubles_of(face: RunningFace) -> list[str]:
    """Return the troubles in the face's status; empty if the face does not answer."""
    try:
        return [str(each) for each in ask(face.path, "status", _ANSWER_S).get("troubles", ())]
    except OSError:
        return []


def release(port: str, face: "FaceSettings | None" = None) -> Outcome:
    """Switch torque off at a port, ending lipservo processes that hold it; return the outcome.

    port: or several, as `bus=port,...`. face: settings of the face whose servos must confirm; None:
    all servos that were driven at the port since it was plugged in, or that answer there.
    """
    named = named_ports(port)
    if named is not None:
        return _release_all(port, named, {} if face is None else face.alone)
    # Imported only here: a stop of a face that answers does not wait for it to be loaded.
    from firmware_bridge.process.port_record import buses_at

    outcome = Outcome(port, port)
    _end_port_holders(port)
    buses = buses_at(port) if face is None else [(face.bus_kind, face.bus)]
    for kind, driven in buses:
        wiring = None if face is None else face.wiring
        _merge_into(outcome, _release_board(port, kind, driven, wiring, shared=len(buses) > 1))
    return outcome


def _release_board(
    port: str,
    kind: "BusKind",
    driven_settings: "BusSettings | None",
    wiring: "Wiring | None",
    *,
    shared: bool,
) -> Outcome:
    """Switch torque off on one board at a port and return the outcome.

    kind: of the board's bus; if none of its servos answers and `wiring` is not known, servos of
    other kinds are searched for. driven_settings: of the bus when it was driven last;
    None: not known. wiring: its joints; None: not known. shared: other boards use the same port, so
    each servo is named with its board.
    """
    from firmware_bridge.bus_kinds import AT_A_PORT, Wiring, other_line_kinds
    from firmware_bridge.bus_settings import BusSettings
    from firmware_bridge.process.torque_release import release_port

    board = f" at {driven_settings.board}" if shared and driven_settings is not None else ""
    if wiring is None and driven_settings is not None and kind.name != AT_A_PORT:
        wiring = Wiring(driven_settings, (), (), 1.0)  # no joints: all servos of the board
    ids = [] if wiring is None else [joint.servo_id for joint in wiring.joints]
    try:
        others = other_line_kinds(kind.name) if wiring is None else iter(())
        while True:
            result = release_port(kind.port_release(port, wiring), ids, timeout_s=_PORT_S)
            is_empty = not (result.confirmed or result.unconfirmed or result.released)
            other = next(others, None) if is_empty else None
            if other is None:
                break
            kind = other
    except BusError as error:
        return Outcome(port, port, problem=str(error))
    outcome = Outcome(port, port)
    outcome.confirmed = [f"id {each}{board}" for each in result.confirmed]
    outcome.unconfirmed = {f"id {each}{board}": why for each, why in result.unconfirmed.items()}
    if result.released:
        outcome.released = [f"{kind.servo.address_key} {each}{board}" for each in result.released]
        can = kind.capabilities(driven_settings or BusSettings(kind=kind.name, port=port))
        outcome.released_words = can.released_words
    if is_empty:
        outcome.problem = f"no servo answers there{board}"
    return outcome


def _release_all(
    name: str, ports: Mapping[str, str], faces: "Mapping[str, FaceSettings]"
) -> Outcome:
    """Switch torque off at several ports at once, by bus name; return one combined outcome.

    name: of the face, for the outcome. faces: settings of single buses whose servos must confirm,
    by bus name; may lack some.
    """
    outcome = Outcome(name, name)
    with ThreadPoolExecutor(len(ports), thread_name_prefix="release") as pool:
        releases = {bus: pool.submit(release, port, faces.get(bus)) for bus, port in ports.items()}
        for bus, released in releases.items():
            _merge_into(outcome, released.result(), bus if len(ports) > 1 else "")
    return outcome


def faces_at(port: str, faces: Sequence[RunningFace]) -> list[RunningFace]:
    """Return the faces that use a port: have locked it, or report it in their status.

    All are queried at once. port: or several, as `bus=port,...`.
    """
    real = {os.path.realpath(each) for each in ports_in(port)}

    def uses_port(face: RunningFace) -> bool:
        """Return whether a face has locked the port, or else names it in its status.

        Blocks while the face is queried.
        """
        if real & set(_ports_of(face)):
            return True
        try:
            used = ask(face.path, "status", _ANSWER_S).get("port")
        except OSError:
            return False
        return used is not None and bool(real & set(map(os.path.realpath, ports_in(str(used)))))

    with ThreadPoolExecutor(max(1, len(faces)), thread_name_prefix="port") as pool:
        return [face for face, uses in zip(faces, pool.map(uses_port, faces), strict=True) if uses]


def _end_port_holders(port: str) -> None:
    """End lipservo's processes that hold a port: two SIGTERM (limp at once), then SIGKILL.

    Only processes that this user may end. A bridge process is ended with its supervisor, which
    would start it again; any other process without its parent.
    """
    holders = [pid for pid in holders_of(port) if is_ours(pid)]
    pids = list(dict.fromkeys(supervisor_of(pid) or pid for pid in holders))
    if not pids:
        return
    _LOG.warning("process %s holds %s and is ended", ", ".join(map(str, pids)), port)
    for _ in range(2):
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGTERM)
        time.sleep(_POLL_S)
    give_up_s = time.monotonic() + _POLITE_S
    while holders_of(port) and time.monotonic() < give_up_s:
        time.sleep(_POLL_S)
    if any(is_ours(pid) for pid in holders_of(port)):
        _LOG.warning("it does not hear and is killed")
        end_hung(with_children(pids))


def _end_by_force(face: RunningFace, level: StopLevel, outcome: Outcome) -> Outcome:
    """Kill the processes of a face that hangs, switch torque off at its ports; return `outcome`.

    Nothing is killed for a freeze, nor where a process is another user's; the outcome's `problem`
    has the reason.
    """
    if level is StopLevel.FREEZE:
        outcome.problem = "hangs: does not answer, and was not frozen; `lipservo stop --limp`"
        return outcome
    holders = holders_of_socket(face.path)
    if not holders or not all(is_ours(pid) for pid in holders):
        outcome.problem = "hangs: does not answer, and is not ours to end; use sudo"
        return outcome
    pids = with_children(holders)
    ports = {port for pid in pids for port in ports_held_by(pid)}
    _LOG.warning("%s hangs: it does not answer; processes %s are killed", face.name, pids)
    unkilled = end_hung(pids)
    if unkilled:
        outcome.problem = f"processes {unkilled} cannot be killed; switch the servos' power off"
    if ports:
        outcome.port = ",".join(sorted(ports))
        _merge_into(outcome, _release_all(face.name, {each: each for each in sorted(ports)}, {}))
    elif not unkilled:
        outcome.problem = "was killed, and none of its ports was found: `lipservo limp --port PORT`"
    return outcome


def _merge_into(outcome: Outcome, released: Outcome, bus: str = "") -> None:
    """Add the servos and problem of `released` to `outcome`, with `bus` before servo names."""
    prefix = f"{bus} " if bus else ""
    outcome.confirmed += [prefix + each for each in released.confirmed]
    outcome.unconfirmed |= {prefix + each: why for each, why in released.unconfirmed.items()}
    outcome.released += [prefix + each for each in released.released]
    outcome.released_words = outcome.released_words or released.released_words
    problem = f"{bus}: {released.problem}" if bus and released.problem else released.problem
    outcome.problem = "; ".join(filter(None, (outcome.problem, problem)))
