"""Which of the running faces a command means."""

from pathlib import Path

from firmware_bridge.process.control_client import RunningFace, face_at, running_faces
from firmware_bridge.process.runtime_folder import name_in_path
from lipsync.errors import UserError


def chosen_faces(face: str | None, control: Path | None) -> list[RunningFace]:
    """The faces that are meant. Raises UserError for a name that none has, and ControlError."""
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
