"""The files of a running face: settings saved in its YAML, and what its calibration says.

The YAML is written whole or not at all, and its comments stay. Everything raises FaceError, one
line: refused, not_saved, not_available.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from lipservo_client.protocol import FaceError

from lipservo.runtime.speech.expression import ExpressionWishes
from lipservo.settings.settings import FaceSettings, parse_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.errors import UserError
from lipsync.output_file import OutputError, write_whole

_NO_PLACE: Final = "there is no safe place for it; write it by hand"


@dataclass(frozen=True, slots=True)
class NewYaml:
    """A face YAML with other settings, checked, and not written yet."""

    path: Path
    before: str
    text: str

    def write(self) -> None:
        """Write it, unless somebody else has written it meanwhile."""
        if _read(self.path) != self.before:
            raise FaceError("not_saved", f"{self.path.name}: was changed meanwhile; try again")
        try:
            write_whole(self.path, self.text)
        except OutputError as error:
            raise FaceError("not_saved", str(error)) from error


def own_yaml(config: str | None) -> Path:
    """The file of a face that is the user's own. Raises FaceError for one that is shipped."""
    if config is None:
        raise FaceError("refused", "the face does not say where its YAML is")
    if not (config.endswith((".yaml", ".yml")) or "/" in config):
        hint = "make one of your own with `lipservo new-face`, and start that"
        raise FaceError("refused", f"{config} is shipped with lipservo and stays as it is; {hint}")
    return Path(config)


def saved_settings(config: str | None) -> dict[str, Any]:
    """What the face's YAML says of its motion, and how lively its expression is.

    What it leaves out is left out; `expression` is always there.
    """
    path = own_yaml(config)
    face = _parsed(_read(path), path)
    return {**face.motion.model_dump(exclude_none=True), "expression": face.expression.amount}


def with_settings(path: Path, values: Mapping[str, float]) -> NewYaml:
    """The file at `path` with these settings, read back and found to be what was meant."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.util import load_yaml_guess_indent

    before = _read(path)
    face = _parsed(before, path)
    try:
        loaded, indent, offset = load_yaml_guess_indent(before)
        for name, value in values.items():
            section, key = _place(name)
            if section not in loaded:
                loaded[section] = {}
            loaded[section][key] = value
        writer = YAML()
        writer.preserve_quotes = True
        writer.width = 1 << 16
        if indent is not None:
            writer.indent(mapping=2, sequence=indent, offset=offset or 0)
        stream = io.StringIO()
        writer.dump(loaded, stream)
    except (YAMLError, TypeError, ValueError, KeyError) as error:
        raise FaceError("not_saved", f"{path.name}: {_NO_PLACE}") from error
    text = stream.getvalue()
    if _told(_parsed(text, path)) != _wanted(face, values):
        raise FaceError("not_saved", f"{path.name}: {_NO_PLACE}")
    return NewYaml(path, before, text)


def _place(name: str) -> tuple[str, str]:
    """Section and key of a setting in the YAML. Raises FaceError for one that is not kept."""
    if name in ExpressionWishes.PASSING:
        raise FaceError("refused", f"{name} is for the moment and not saved")
    return ("expression", "amount") if name == "expression" else ("motion", name)


def _told(face: FaceSettings) -> dict[str, Any]:
    return face.model_dump(exclude_none=True)


def _wanted(face: FaceSettings, values: Mapping[str, float]) -> dict[str, Any]:
    """All that the face said, but for what is to change."""
    wanted = _told(face)
    for name, value in values.items():
        section, key = _place(name)
        wanted[section] = {**wanted[section], key: value}
    return wanted


def _read(path: Path) -> str:
    try:
        return path.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        raise FaceError("not_saved", f"{path}: cannot be read") from error


def _parsed(text: str, path: Path) -> FaceSettings:
    try:
        return parse_face(text, path.name)
    except SettingsError as error:
        raise FaceError("refused", "; ".join(str(error).splitlines())) from error


def told_calibration(config: str | None) -> dict[str, Any]:
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
    told = shown_values(found, settings.prevent)
    is_current = found.face_checksum == settings.checksum
    return {"file": file.name, "fits_the_face": is_current, **told}
