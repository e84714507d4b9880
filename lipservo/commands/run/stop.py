"""`stop`, `start`, `status`, `limp`: for a person beside the robot, whatever process is dead.

They import only what they need, to start quickly.
"""

import sys
import time
from collections.abc import Callable, Sequence
from errno import EPROTO
from pathlib import Path
from typing import Annotated, Any, Final, TypeGuard

import typer

from firmware_bridge.port_names import ports_in
from firmware_bridge.process.control_client import RunningFace, ask, running_faces, start_face
from firmware_bridge.process.logs import face_logs
from firmware_bridge.process.port_holders import holders_of
from firmware_bridge.stopping import StopLevel
from lipservo.commands.options import Control, FaceName, Json, On, Port
from lipservo.commands.run.running import SILENT, ask_faces, chosen_faces
from lipservo.commands.run.status_words import motion_words, servo_words, state_words
from lipservo.runtime.servos.letting_go import Outcome, faces_at, release, stop_faces
from lipservo.terminal.output import print_json
from lipsync.errors import UserError

#: Switching torque on takes a second or two on real servos, ten on a computer that is very busy.
_START_S = 20.0
_POLL_S = 0.1
#: States of a face that is being started; any other one ends the start.
_STARTING_STATES = ("the bridge starts", "the bridge starts again", "starting", "driven")


_FLAGS: Final = {"--limp": "limp", "--freeze": "freeze", "--end": "end"}


def run_without_parser(arguments: Sequence[str]) -> bool:
    """Run `stop`, `start` or `status` if all options are plain; else return False.

    arguments: of the command line, the command first. The parser takes as long to load as all else
    together. It gets the command lines refused here, and reports what is wrong with them.
    """
    name, words = arguments[0], iter(arguments[1:])
    given: dict[str, Any] = {}
    for word in words:
        if word == "--json":
            given["as_json"] = True
        elif name == "stop" and word in _FLAGS:
            given[_FLAGS[word]] = True
        elif word in ("--face", "--control") or (word == "--on" and name != "start"):
            value = next(words, "-")
            if value.startswith("-"):
                return False
            given[word[2:]] = value if word == "--face" else Path(value)
        else:
            return False
    commands: dict[str, Callable[..., None]] = {"stop": stop, "start": start, "status": status}
    commands[name](**given)
    return True


def stop(
    limp: Annotated[
        bool, typer.Option("--limp", help="Switch torque off at once, without moving to rest.")
    ] = False,
    freeze: Annotated[
        bool, typer.Option("--freeze", help="Hold the present position until the next stop.")
    ] = False,
    end: Annotated[
        bool, typer.Option("--end", help="Also end a daemon, which else waits for `start`.")
    ] = False,
    face: FaceName = None,
    control: Control = None,
    on: On = None,
    as_json: Json = False,
) -> None:
    """Stop every running face: move to rest, then torque off, confirmed by its servos.

    A face that is frozen is let go where it is. A daemon then waits for `lipservo start`; a
    `lipservo run` ends. The command also works if the speech process is dead. Exit status 1 unless
    every servo has confirmed; hobby servos cannot: 0 then means pulses off.
    """
    if limp and freeze:
        raise UserError("--limp and --freeze: give one of them")
    if freeze and end:
        raise UserError("--freeze and --end: a face that has ended holds nothing")
    level = StopLevel.LIMP if limp else StopLevel.FREEZE if freeze else StopLevel.SOFT
    if _is_for_kiosks(on, face, control):
        from lipservo.commands.run.kiosks import stop_kiosks

        stop_kiosks(on, level, end=end, as_json=as_json)
        return
    faces = chosen_faces(face, control)
    if not faces:
        raise UserError("no face answers; `lipservo limp --port PORT` switches torque off")
    with face_logs(face or ""):
        outcomes = stop_faces(faces, level, end=end)
    _print_outcomes(outcomes, as_json=as_json)


def start(face: FaceName = None, control: Control = None, as_json: Json = False) -> None:
    """Drive a stopped face again, after the usual checks. It moves: keep your hands away.

    Every servo is tried again, also one that the face had given up. Exit status 1 unless all servos
    hold.
    """

    def started(each: RunningFace) -> dict[str, Any]:
        answer = start_face(each.path)
        return answer if "error" in answer else _await_driven(each)

    ask_faces(face, control, started, lambda one: f"driven{servo_words(one)}", as_json=as_json)


def _await_driven(face: RunningFace) -> dict[str, Any]:
    """Poll a started face until all servos hold that are not switched off, 20 s at most.

    Returns {"state", "servos", "torque"} of the last status, or {"error": reason} if they do not.
    """
    give_up_s = time.monotonic() + _START_S
    while True:
        try:
            current = ask(face.path, "status")
        except TimeoutError:
            current = {"state": _STARTING_STATES[0]}
        state, servos = current.get("state"), dict(current.get("servos") or {})
        troubles = "; ".join(current.get("troubles") or ())
        if state == "driven" and servos and set(servos.values()) <= {"driven", "off"}:
            return {"state": state, "servos": servos, "torque": current.get("torque")}
        if state not in _STARTING_STATES:
            return {"error": troubles or f"not driven: {state}"}
        if time.monotonic() > give_up_s:
            state_text = f"{state}{servo_words(current)}" if servos else f"not driven: {state}"
            return {"error": "; ".join(filter(None, (state_text, troubles)))}
        time.sleep(_POLL_S)


def _is_for_kiosks(on: Path | None, face: str | None, control: Path | None) -> TypeGuard[Path]:
    """Return whether --on names faces of other computers. Raises UserError beside a face here."""
    if on is not None and (face is not None or control is not None):
        raise UserError("--on, --face, --control: give one of them")
    return on is not None


def status(
    face: FaceName = None, control: Control = None, on: On = None, as_json: Json = False
) -> None:
    """List the running faces: name, process, port, state, servos, troubles.

    With --on: exit status 1 unless all listed faces answer.
    """
    if _is_for_kiosks(on, face, control):
        from lipservo.commands.run.kiosks import status_of_kiosks

        status_of_kiosks(on, as_json=as_json)
        return
    found = [_status_of(each) for each in chosen_faces(face, control)]
    if as_json:
        print_json({"faces": found})
        return
    if not found:
        sys.stderr.write("no face runs\n")
    for each in found:
        port = each.get("port") or "simulated servos"
        sys.stdout.write(f"{each['name']}  process {each['pid']}  {port}  {state_words(each)}\n")
        for line in filter(None, (motion_words(each), *each.get("troubles", ()))):
            sys.stdout.write(f"  {line}\n")


def limp(
    port: Port = None,
    config: Annotated[
        str | None,
        typer.Option(
            help="Switch off the servos of this face, at --port or at the port in its YAML."
        ),
    ] = None,
    unless_held: Annotated[
        bool,
        typer.Option(
            "--unless-held", help="Do nothing while a program uses the port; for services."
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Switch torque off: ask the running face to do so, then do it directly at its port.

    Without --port and --config: for all running faces. The command also works if the program that
    uses the port is dead or hangs. Exit status 1 unless every servo has confirmed; hobby servos
    cannot: 0 then means pulses off.
    """
    settings, refused = None, None
    if config is not None:
        from lipservo.runtime.servos.assembly import load_settings

        try:
            given = load_settings(config)[0]
            port = port or given.servo_port
            if port is None:
                raise UserError(f"{config}: names no port; add --port PORT")
            settings = given.at_port(port)
        except UserError as error:  # no reason to leave torque on
            if port is None:
                raise
            refused = UserError(f"{error}\nwithout that file all servos found at {port} are let go")
    if unless_held and port is not None:
        held_by = [pid for each in ports_in(port) for pid in holders_of(each)]
        if held_by:
            sys.stderr.write(f"{port}: held by process {held_by[0]}, and left alone\n")
            return
    faces = running_faces() if port is None else faces_at(port, running_faces())
    with face_logs(""):
        outcomes = stop_faces(faces, StopLevel.LIMP)
        if port is not None:
            outcomes.append(release(port, settings))
    if not outcomes:
        raise UserError("no face runs; give --port PORT to let go of the servos there")
    try:
        _print_outcomes(outcomes, as_json=as_json)
    finally:
        if refused is not None:
            raise refused


def _status_of(face: RunningFace) -> dict[str, Any]:
    """Return a face's status; if it does not answer, its name, pid, and the reason as `state`."""
    found: dict[str, Any] = {"name": face.name, "pid": face.pid, "port": None}
    try:
        answer = ask(face.path, "status")
    except TimeoutError:
        return {**found, "state": f"{SILENT}; if it has hung, `lipservo stop --limp` ends it"}
    except PermissionError:
        return {**found, "state": "may not be queried; use sudo"}
    except OSError as error:
        return {**found, "state": error.strerror if error.errno == EPROTO else "has just ended"}
    return {"state": "runs", **found, **answer, "pid": face.pid}


def _print_outcomes(outcomes: list[Outcome], *, as_json: bool) -> None:
    """Print the outcomes of a stop; raise typer.Exit with 1 unless every servo has confirmed."""
    if as_json:
        print_json({"faces": [outcome.as_dict() for outcome in outcomes]})
    else:
        for outcome in outcomes:
            sys.stdout.write(f"{outcome.text()}\n")
    if not all(outcome.is_confirmed for outcome in outcomes):
        raise typer.Exit(1)
