"""Selection of the running faces that a command is for, and the printing of their answers."""

import sys
from collections.abc import Callable
from errno import EPROTO
from pathlib import Path
from typing import Any, Final

import typer

from firmware_bridge.process.control_client import PATIENCE_S, RunningFace, face_at, running_faces
from firmware_bridge.process.runtime_folder import name_in_path
from lipservo.terminal.output import complain, print_json
from lipsync.errors import UserError

Answer = dict[str, Any]
#: Of a face that may have hung.
SILENT: Final = f"has not answered within {PATIENCE_S:g} s"


def chosen_faces(face: str | None, control: Path | None) -> list[RunningFace]:
    """Return the running faces: the one at `control`, else those named `face`, else all.

    Raises UserError for a name that no running face has, and ControlError.
    """
    if control is not None:
        return [face_at(control)]
    faces = running_faces()
    if face is None:
        return faces
    chosen = [each for each in faces if each.name == name_in_path(face)]
    if not chosen:
        names = ", ".join(sorted({each.name for each in faces})) or "none"
        raise UserError(f"--face {face}: no such face runs; running: {names}")
    return chosen


def ask_faces(
    face: str | None,
    control: Path | None,
    ask_one: Callable[[RunningFace], Answer],
    line: Callable[[Answer], str],
    *,
    as_json: bool,
) -> None:
    """Send a request to each chosen face; print its answer as a line, or all answers as JSON.

    face, control: as of `chosen_faces`. ask_one: sends the request to one face, and returns the
    answer, {"error": one line} if it was refused. line: returns an answer as text. Raises UserError
    where no face runs, typer.Exit with 1 where one refused or did not answer.
    """
    faces = chosen_faces(face, control)
    if not faces:
        raise UserError("no face answers; start one with `lipservo daemon`")
    answers = [{"name": each.name, **_answer_or_error(each, ask_one)} for each in faces]
    if as_json:
        print_json({"faces": answers})
    for answer in answers:
        if "error" in answer:
            complain(f"{answer['name']}: {answer['error']}")
        elif not as_json:
            sys.stdout.write(f"{answer['name']}: {line(answer)}\n")
    if any("error" in answer for answer in answers):
        raise typer.Exit(1)


def _answer_or_error(face: RunningFace, ask_one: Callable[[RunningFace], Answer]) -> Answer:
    """Return a face's answer to `ask_one`; {"error": reason} if the face cannot be queried."""
    try:
        return ask_one(face)
    except TimeoutError:
        return {"error": SILENT}
    except PermissionError:
        return {"error": "may not be queried; use sudo"}
    except OSError as error:
        return {"error": str(error.strerror) if error.errno == EPROTO else "has just ended"}
