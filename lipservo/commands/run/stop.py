"""`stop`, `start`, `status`, `limp`: for a person beside the robot, whatever process is dead.

They import only what they need, to start quickly.
"""

import sys
import time
from collections.abc import Sequence
from errno import EPROTO
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from firmware_bridge.port_names import ports_in
from firmware_bridge.process.control_client import RunningFace, ask, running_faces, start_face
from firmware_bridge.process.logs import face_logs
from firmware_bridge.process.port_holders import holders_of
from firmware_bridge.stopping import StopLevel
from lipservo.commands.options import Control, FaceName, Json, Port
from lipservo.commands.run.running import ask_faces, chosen_faces
from lipservo.runtime.servos.letting_go import Outcome, faces_at, release, stop_faces
from lipservo.terminal.output import print_json
from lipsync.errors import UserError

_STATUS_S = 1.0
#: Arming takes a second or two on real servos, ten on a computer that is very busy.
_START_S = 20.0
_LOOK_EVERY_S = 0.1
#: While it is brought up; any other state is the end of it.
_ON_ITS_WAY = ("the bridge starts", "the bridge starts again", "starting", "driven")


_FLAGS: Final = {"--limp": "limp", "--freeze": "freeze", "--end": "end"}


def run_without_parser(arguments: Sequence[str]) -> bool:
    """Run `stop`, `start` or `status` if all options are plain; else return False.

    arguments: of the command line, the command first. The parser takes as long to load as all else
    together; it reports the options unknown here.
    """
    name, left = arguments[0], iter(arguments[1:])
    given: dict[str, Any] = {}
    for word in left:
        if word == "--json":
            given["as_json"] = True
        elif name == "stop" and word in _FLAGS:
            given[_FLAGS[word]] = True
        elif word in ("--face", "--control"):
            value = next(left, "-")
            if value.startswith("-"):
                return False
            given[word[2:]] = value if word == "--face" else Path(value)
        else:
            return False
    if name == "stop":
        stop(**given)
    elif name == "start":
        start(**given)
    else:
        status(**given)
    return True


def stop(
    limp: Annotated[bool, typer.Option("--limp", help="Let go at once, wherever it is.")] = False,
    freeze: Annotated[
        bool, typer.Option("--freeze", help="Stay where it is, held, until the next stop.")
    ] = False,
    end: Annotated[
        bool, typer.Option("--end", help="End a daemon too; otherwise it waits for `start`.")
    ] = False,
    face: FaceName = None,
    control: Control = None,
    as_json: Json = False,
) -> None:
    """Stop every running face: to rest and limp, confirmed by its servos.

    A daemon then waits for `lipservo start`; a `run` ends. Works although the speech side is dead.
    Exit status 1 unless every servo has confirmed.
    """
    if limp and freeze:
        raise UserError("--limp and --freeze: give one of them")
    if freeze and end:
        raise UserError("--freeze and --end: a face that has ended holds nothing")
    level = StopLevel.LIMP if limp else StopLevel.FREEZE if freeze else StopLevel.SOFT
    faces = chosen_faces(face, control)
    if not faces:
        raise UserError("no face answers; `lipservo limp --port PORT` switches torque off")
    with face_logs(face or ""):
        outcomes = stop_faces(faces, level, end=end)
    done = {
        StopLevel.SOFT: "at rest and limp",
        StopLevel.LIMP: "limp",
        StopLevel.FREEZE: "held where it is until the next stop",
    }
    _report(outcomes, done[level], as_json=as_json)


def start(face: FaceName = None, control: Control = None, as_json: Json = False) -> None:
    """Drive a stopped face again, through the ordinary checks. It moves: keep your hands away.

    Every servo is tried again, one that was given up, too. Exit status 1 unless all hold.
    """

    def started(each: RunningFace) -> dict[str, Any]:
        answer = start_face(each.path)
        return answer if "error" in answer else _come_back(each)

    ask_faces(face, control, started, lambda one: f"driven{_servos(one)}", as_json=as_json)


def _come_back(face: RunningFace) -> dict[str, Any]:
    """Poll a started face until all servos hold that are not switched off, 20 s at most.

    Returns {"state", "servos", "torque"} as of a status, or {"error": why} if they do not.
    """
    give_up_s = time.monotonic() + _START_S
    while True:
        try:
            found = ask(face.path, "status", _STATUS_S)
        except TimeoutError:
            found = {"state": _ON_ITS_WAY[0]}
        state, servos = found.get("state"), dict(found.get("servos") or {})
        troubles = "; ".join(found.get("troubles") or ())
        if state == "driven" and servos and set(servos.values()) - {"off"} == {"driven"}:
            return {"state": state, "servos": servos, "torque": found.get("torque")}
        if state not in _ON_ITS_WAY:
            return {"error": troubles or f"not driven: {state}"}
        if time.monotonic() > give_up_s:
            without = f"{state}{_servos(found)}" if servos else f"not driven: {state}"
            return {"error": "; ".join(filter(None, (without, troubles)))}
        time.sleep(_LOOK_EVERY_S)


def status(face: FaceName = None, control: Control = None, as_json: Json = False) -> None:
    """List the running faces: name, process, port, state, servos, troubles."""
    found = [_status_of(each) for each in chosen_faces(face, control)]
    if as_json:
        print_json({"faces": found})
        return
    if not found:
        sys.stderr.write("no face runs\n")
    for each in found:
        port = each.get("port") or "simulated servos"
        sys.stdout.write(f"{each['name']}  process {each['pid']}  {port}  {_state(each)}\n")
        for line in filter(None, (_motion(each), *each.get("troubles", ()))):
            sys.stdout.write(f"  {line}\n")


def limp(
    port: Port = None,
    config: Annotated[
        str | None,
        typer.Option(
            help="Let go of this face's servos, at --port or the port of its YAML.",
            show_default=False,
        ),
    ] = None,
    unless_held: Annotated[
        bool,
        typer.Option(
            "--unless-held", help="Leave the port alone while a program holds it; for services."
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Let everything go, whatever held it: asks the face, then switches torque off at its port.

    Without --port and --config: all running faces. Works when whatever held the port is dead or
    hangs. Exit status 1 unless every servo has confirmed.
    """
    settings = None
    if config is not None:
        from lipservo.runtime.servos.assembly import load_settings

        settings = load_settings(config)[0]
        port = port or settings.servo_port
        if port is None:
            raise UserError(f"{config}: names no port; add --port PORT")
        settings = settings.at_port(port)
    if unless_held and port is not None:
        held_by = [pid for each in ports_in(port) for pid in holders_of(each)]
        if held_by:
            sys.stderr.write(f"{port}: held by process {held_by[0]}, and left alone\n")
            return
    faces = running_faces()
    if port is not None:
        faces = faces_at(port, faces)
    with face_logs(""):
        outcomes = stop_faces(faces, StopLevel.LIMP)
        if port is not None:
            outcomes.append(release(port, settings))
    if not outcomes:
        raise UserError("no face runs; give --port PORT to let go of the servos there")
    _report(outcomes, "limp", as_json=as_json)


def _status_of(face: RunningFace) -> dict[str, Any]:
    found: dict[str, Any] = {"name": face.name, "pid": face.pid, "port": None}
    try:
        answer = ask(face.path, "status", _STATUS_S)
    except TimeoutError:
        return {**found, "state": "hangs: does not answer; `lipservo stop --limp` ends it"}
    except PermissionError:
        return {**found, "state": "may not be queried; use sudo"}
    except OSError as error:
        return {**found, "state": error.strerror if error.errno == EPROTO else "has just ended"}
    return {"state": "runs", **found, **answer, "pid": face.pid}


def _state(status: dict[str, Any]) -> str:
    """Return a face's state as text: its stop report, a missing port, or its servos that hold."""
    report = status.get("stop_report")
    if status["state"] == "stopped" and report is not None:
        n, left = len(report["confirmed"]), ", ".join(report["unconfirmed"])
        words = [report.get("released_words"), f"limp, confirmed by {n} servos"]
        limp = "; ".join(filter(None, words if n else words[:1])) or words[1]
        limp += f", NOT by {left}" if left else ""
        limp += "; `lipservo start` drives it" if status.get("can_start") else ""
        return f"stopped by {status.get('stopped_by')}: {limp}"
    if status.get("plugged") is False:
        return f"{status['state']}, but its port is gone: no servo can be reached"
    return f"{status['state']}{_servos(status)}"


def _servos(status: dict[str, Any]) -> str:
    known = [each.get("on") for each in dict(status.get("torque") or {}).values()]
    if set(known) == {None}:
        return ", it is not known which servos hold"
    unknown = f", not known of {known.count(None)}" if None in known else ""
    return f", {known.count(True)} of {len(known)} servos hold{unknown}" if known else ""


def _motion(status: dict[str, Any]) -> str:
    """Return a speaking face's sound, strategy, settings and recogniser as one line; else empty."""
    if status.get("strategy") is None:
        return ""
    level = status["fallback_level"]
    fallback = f" (fallback {level})" if level else ""
    listens = f"; listens at {status['listens_on']}" if status.get("listens_on") else ""
    named = "".join(f", {name} {value:g}" for name, value in status["settings"].items())
    opens = "; does not close" if status.get("mouth_closes") is False else ""
    heard = f"{status['recognizer']}{fallback}{listens}{opens}"
    return f"{status['sound']}: {status['strategy']}{named}; {heard}"


def _report(outcomes: list[Outcome], done: str, *, as_json: bool) -> None:
    if as_json:
        print_json({"faces": [outcome.as_dict() for outcome in outcomes]})
    else:
        for outcome in outcomes:
            sys.stdout.write(f"{outcome.text(done)}\n")
    if not all(outcome.is_confirmed for outcome in outcomes):
        raise typer.Exit(1)
