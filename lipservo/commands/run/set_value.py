"""The command `set`, which changes a setting of running faces."""

import time
from typing import Annotated, Any

import typer

from firmware_bridge.process.control_client import RunningFace, change_settings
from lipservo.commands.options import Control, FaceName, Json
from lipservo.commands.run.running import ask_faces
from lipservo.runtime.speech.passing_wish import with_expiry


def set_value(
    name: Annotated[
        str,
        typer.Argument(
            help="Setting: strength, stage, smoothness, unit_share (docs/motion.md), "
            "lip_gap_offset_mm, expression, look_yaw_deg, look_pitch_deg, look_weight (0: no gaze "
            "target), affect_valence, affect_arousal, affect_tau_s (docs/expression.md)."
        ),
    ],
    value: Annotated[float, typer.Argument(help="New value.")],
    face: FaceName = None,
    control: Control = None,
    as_json: Json = False,
) -> None:
    """Change a setting of the running faces, smoothly; it lasts until the face ends.

    A gaze target (look_...) holds from then on; a mood (affect_...) fades by itself. Exit status 1
    unless every face has accepted the value.
    """

    def request(each: RunningFace) -> dict[str, Any]:
        answer = change_settings(each.path, with_expiry({name: value}, time.monotonic()))
        return answer if "error" in answer else {**answer, "set": name, "value": value}

    def answer_line(answer: dict[str, Any]) -> str:
        return f"{name} is {answer['value']:g} from now on"

    ask_faces(face, control, request, answer_line, as_json=as_json)
