"""`set`: what may change while a face runs."""

from typing import Annotated

import typer

from firmware_bridge.process.control_client import RunningFace, change_setting
from lipservo.commands.options import Control, FaceName, Json
from lipservo.commands.run.running import chosen_faces
from lipservo.terminal.output import RESULTS, complain, print_json
from lipsync.errors import UserError


def set_value(
    name: Annotated[str, typer.Argument(help="What: strength or smoothness.")],
    value: Annotated[float, typer.Argument(help="To which value.")],
    face: FaceName = None,
    control: Control = None,
    as_json: Json = False,
) -> None:
    """Change a setting of every running face, eased in over 0.3 s; it lasts until the face ends.

    Exit status 1 unless every face has taken it.
    """
    faces = chosen_faces(face, control)
    if not faces:
        raise UserError("no face answers; is a face running?")
    answers = [{"name": each.name, **_answer(each, name, value)} for each in faces]
    if as_json:
        print_json({"faces": answers})
    for answer in answers:
        if "error" in answer:
            complain(f"{answer['name']}: {answer['error']}")
        elif not as_json:
            line = f"{answer['name']}: {answer['set']} is {answer['value']:g} from now on"
            RESULTS.print(line, soft_wrap=True, markup=False, highlight=False)
    if any("error" in answer for answer in answers):
        raise typer.Exit(1)


def _answer(face: RunningFace, name: str, value: float) -> dict[str, object]:
    try:
        return change_setting(face.path, name, value)
    except TimeoutError:
        return {"error": "hangs: does not answer"}
    except PermissionError:
        return {"error": "may not be asked; use sudo"}
    except OSError:
        return {"error": "has just ended"}
