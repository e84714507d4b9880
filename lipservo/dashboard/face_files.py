"""The files of a running face: settings saved in its YAML, and what its calibration says.

The YAML is written whole or not at all, and its comments stay. Everything raises FaceError, one
line: refused, not_saved, not_available.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lipservo_client.protocol import FaceError

from lipservo.runtime.speech.expression import ExpressionRequests
from lipservo.settings import found_limits
from lipservo.settings.edited_yaml import EditedYaml, Place, edited, read_face_text
from lipservo.settings.found_limits import PulseLimit
from lipservo.settings.settings import parse_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.errors import UserError


def own_yaml(config: str | None) -> Path:
    """The file of a face that is the user's own. Raises FaceError for one that is shipped."""
    if config is None:
        raise FaceError("refused", "the face does not say where its YAML is")
    try:
        return found_limits.own_yaml(config)
    except UserError as error:
        raise FaceError("refused", str(error)) from error


def set_pulse_limit(
    config: str | None, servo: str, limit: PulseLimit, pulse_us: float
) -> dict[str, Any]:
    """Write one limit of a hobby servo into the face's YAML: the numbers of all, and what next."""
    path = own_yaml(config)
    with face_errors():
        edit = found_limits.with_pulse_limit(path, servo, limit, pulse_us)
        edit.write()
        after = parse_face(edit.text, path.name).servos[servo]
    degrees = {"min_deg": after.min_deg, "max_deg": after.max_deg}
    assert after.pulse is not None  # checked by `with_pulse_limit`
    pulse = asdict(after.pulse)
    return {"servo": servo, "set": {**pulse, **degrees}, "note": found_limits.what_next(edit)}


def saved_settings(config: str | None) -> dict[str, Any]:
    """What the face's YAML says of its motion, and how lively its expression is.

    What it leaves out is left out; `expression` is always there.
    """
    path = own_yaml(config)
    with face_errors():
        face = parse_face(_text(path), path.name)
    return {**face.motion.model_dump(exclude_none=True), "expression": face.expression.amount}


def with_settings(path: Path, values: Mapping[str, float]) -> EditedYaml:
    """The file at `path` with these settings, read back and found to be what was meant."""
    places = {_place(name): value for name, value in values.items()}
    _text(path)
    with face_errors():
        return edited(path, places)


@contextmanager
def face_errors() -> Iterator[None]:
    """What a file says wrong is refused; what cannot be written is not saved."""
    try:
        yield
    except SettingsError as error:
        raise FaceError("refused", "; ".join(str(error).splitlines())) from error
    except UserError as error:
        raise FaceError("not_saved", str(error)) from error


def _place(name: str) -> Place:
    """Section and key of a setting in the YAML. Raises FaceError for one that is not kept."""
    if name in ExpressionRequests.PASSING:
        raise FaceError("refused", f"{name} is for the moment and not saved")
    return ("expression", "amount") if name == "expression" else ("motion", name)


def _text(path: Path) -> str:
    try:
        return read_face_text(path)
    except SettingsError as error:
        raise FaceError("not_saved", str(error)) from error


def calibration_values(config: str | None) -> dict[str, Any]:
    """The same as `lipservo calibrate show --json`, with the file's name. Raises FaceError."""
    from calibration.files.calibration_file import parse_calibration
    from lipservo.calibrating.shown_calibration import shown_values
    from lipservo.runtime.servos.assembly import load_settings
    from lipservo.settings.settings import calibration_file

    if config is None:
        raise FaceError("not_available", "the face does not say where its YAML is")
    try:
        settings, folder = load_settings(config)
        file = calibration_file(settings, folder)
        found = parse_calibration(file.read_text(encoding="utf-8"), file.name)
    except (UserError, OSError, UnicodeDecodeError) as error:
        raise FaceError("not_available", " ".join(str(error).split())) from error
    values = shown_values(found, settings.prevent)
    is_current = found.face_checksum == settings.checksum
    return {"file": file.name, "fits_the_face": is_current, **values}
