"""`stop`, `status`, `limp`: what a person beside the robot needs, whatever else is dead.

Somebody waits for these: they load nothing that they do not use.
"""

import os
from typing import Annotated, Any

import typer

from firmware_bridge.process.control_client import RunningFace, ask, running_faces
from firmware_bridge.process.port_holders import holders_of
from firmware_bridge.stopping import StopLevel
from lipservo.commands.options import Control, FaceName, Json, Port
from lipservo.commands.run.running import chosen_faces
from lipservo.face.letting_go import Outcome, port_of, release, stop_face
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError

_STATUS_S = 1.0


def stop(
    limp: Annotated[bool, typer.Option("--limp", help="Let go at once, wherever it is.")] = False,
    freeze: Annotated[
        bool, typer.Option("--freeze", help="Stay where it is, held, until the next stop.")
    ] = False,
    face: FaceName = None,
    control: Control = None,
    as_json: Json = False,
) -> None:
    """Stop every running face: to rest and limp, confirmed by its servos.

    Works although the speech side is dead. Exit status 1 unless every servo has confirmed.
    """
    if limp and freeze:
        raise UserError("--limp and --freeze: give one of them")
    level = StopLevel.LIMP if limp else StopLevel.FREEZE if freeze else StopLevel.SOFT
    faces = chosen_faces(face, control)
    if not faces:
        raise UserError("no face answers; is a face running? `lipservo limp --port PORT` lets go")
    outcomes = [stop_face(each, level, _say) for each in faces]
    done = {
        StopLevel.SOFT: "at rest and limp",
        StopLevel.LIMP: "limp",
        StopLevel.FREEZE: "held where it is until the next stop",
    }
    _report(outcomes, done[level], as_json=as_json)


def status(face: FaceName = None, control: Control = None, as_json: Json = False) -> None:
    """List the running faces: name, process, port, state, servos, troubles."""
    found = [_status_of(each) for each in chosen_faces(face, control)]
    if as_json:
        print_json({"faces": found})
        return
    if not found:
        MESSAGES.print("no face runs")
    for each in found:
        port = each.get("port") or "simulated servos"
        line = f"{each['name']}  process {each['pid']}  {port}  {each['state']}{_servos(each)}"
        RESULTS.print(line, soft_wrap=True, markup=False, highlight=False)
        for line in (_motion(each), *each.get("troubles", ())):
            if not line:
                continue
            RESULTS.print(f"  {line}", soft_wrap=True, markup=False, highlight=False)


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
    rate, ids = None, []
    if config is not None:
        from lipservo.face.assembly import load_settings

        settings = load_settings(config)[0]
        rate, ids = settings.bus.baud_rate, [joint.servo_id for joint in settings.joints()]
        port = port or (settings.bus.port if settings.bus.kind == "dynamixel" else None)
        if port is None:
            raise UserError(f"{config}: names no port; add --port PORT")
    if unless_held and port is not None and (held_by := holders_of(port)):
        _say(f"{port}: held by process {held_by[0]}, and left alone")
        return
    real = None if port is None else os.path.realpath(port)
    faces = [each for each in running_faces() if port is None or port_of(each) == real]
    outcomes = [stop_face(each, StopLevel.LIMP, _say) for each in faces]
    if port is not None:
        outcomes.append(release(port, rate, ids, say=_say))
    if not outcomes:
        raise UserError("no face runs; give --port PORT to let go of the servos there")
    _report(outcomes, "limp", as_json=as_json)


def _say(line: str) -> None:
    MESSAGES.print(line, soft_wrap=True, markup=False, highlight=False)


def _status_of(face: RunningFace) -> dict[str, Any]:
    found: dict[str, Any] = {"name": face.name, "pid": face.pid, "port": None}
    try:
        answer = ask(face.path, "status", _STATUS_S)
    except TimeoutError:
        return {**found, "state": "hangs: does not answer; `lipservo stop --limp` ends it"}
    except PermissionError:
        return {**found, "state": "may not be asked; use sudo"}
    except OSError:
        return {**found, "state": "has just ended"}
    return {"state": "runs", **found, **answer, "pid": face.pid}


def _servos(status: dict[str, Any]) -> str:
    states = list(dict(status.get("servos") or {}).values())
    if not states:
        return ""
    return f", {states.count('driven')} of {len(states)} servos driven"


def _motion(status: dict[str, Any]) -> str:
    """Strategy and recogniser of a face that speaks, and what is set."""
    if status.get("strategy") is None:
        return ""
    level = status["fallback_level"]
    fallback = f" (fallback {level})" if level else ""
    listens = f"; listens at {status['listens_on']}" if status.get("listens_on") else ""
    named = "".join(f", {name} {value:g}" for name, value in status["settings"].items())
    return (
        f"{status['sound']}: {status['strategy']}{named}; {status['recognizer']}{fallback}{listens}"
    )


def _report(outcomes: list[Outcome], done: str, *, as_json: bool) -> None:
    if as_json:
        print_json({"faces": [outcome.as_dict() for outcome in outcomes]})
    else:
        for outcome in outcomes:
            RESULTS.print(outcome.text(done), soft_wrap=True, markup=False, highlight=False)
    if not all(outcome.is_confirmed for outcome in outcomes):
        raise typer.Exit(1)
