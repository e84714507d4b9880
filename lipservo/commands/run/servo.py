"""The command `servo`, which switches one servo of a running face off, on, or restarts it.

It imports only what it needs, to start quickly.
"""

import time
from typing import Annotated, Any, Final

import typer

from firmware_bridge.process.control_client import RunningFace, ask, switch_servo
from firmware_bridge.stopping import ServoSwitch
from lipservo.commands.options import Control, FaceName, Json
from lipservo.commands.run.running import ask_faces

#: What the servo is once it has done what was asked; a restarted one may be either.
_DONE: Final = {
    ServoSwitch.OFF: ("off",),
    ServoSwitch.ON: ("driven",),
    ServoSwitch.REBOOT: ("driven", "off", "failed"),
}
#: A restart takes a second, coming on again half of one, and a servo may miss a question or two.
_PATIENCE_S: Final = 5.0
_LOOK_EVERY_S: Final = 0.1


def servo(
    name: Annotated[str, typer.Argument(help="Name of the servo's joint.")],
    switch: Annotated[
        ServoSwitch,
        typer.Argument(help="off: torque off; on: drive the servo again; reboot: restart it."),
    ],
    face: FaceName = None,
    control: Control = None,
    as_json: Json = False,
) -> None:
    """Switch one servo of a running face off or on, or restart it; the others continue.

    Exit status 1 unless the servo has confirmed. `on` of a stopped face is accepted with status 0,
    and done when the face is started.
    """

    def request(each: RunningFace) -> dict[str, Any]:
        before = _n_reboots(ask(each.path, "status"), name)
        answer = switch_servo(each.path, name, switch)
        return answer if "error" in answer else {**answer, **_wait_for(each, name, switch, before)}

    def answer_line(answer: dict[str, Any]) -> str:
        return answer.get("then") or f"servo {name} is {answer['state']}"

    ask_faces(face, control, request, answer_line, as_json=as_json)


def _n_reboots(status: dict[str, Any], name: str) -> int:
    """Return how often the face has restarted servo `name`, by the `health` in its status."""
    return sum(each["n_reboots"] for each in status.get("health") or () if each["name"] == name)


def _wait_for(face: RunningFace, name: str, switch: ServoSwitch, n_before: int) -> dict[str, Any]:
    """Poll the face until servo `name` has switched, 5 s at most.

    n_before: its number of restarts before the request; one requested is done once there are more.
    Returns {"state"}; also "error", one line, if that is not the state requested, or "then", a
    line, where a stopped face will switch the servo at its start.
    """
    give_up_s = time.monotonic() + _PATIENCE_S
    while True:
        status = ask(face.path, "status")
        state = dict(status.get("servos") or {}).get(name, "unknown")
        if switch is ServoSwitch.ON and status.get("stopped") is not None:
            return {"state": state, "then": f"servo {name} comes on when the face is started"}
        report = status.get("stop_report") or {}
        released = (*report.get("confirmed", ()), *report.get("released", ()))
        if switch is ServoSwitch.OFF and state == "unknown" and name in released:
            return {"state": "off", "then": f"servo {name} stays off when the face is started"}
        is_due = switch is ServoSwitch.REBOOT and _n_reboots(status, name) <= n_before
        if state in _DONE[switch] and not is_due:
            return {"state": state}
        if time.monotonic() > give_up_s:
            troubles = [
                line for line in status.get("troubles", ()) if f"'{name}'" in line and not is_due
            ]
            what = "has not restarted" if is_due else f"is {state}"
            return {"state": state, "error": "; ".join(troubles) or f"servo {name} {what}"}
        time.sleep(_LOOK_EVERY_S)
