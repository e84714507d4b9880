"""Edits of values in a face YAML that leave comments, order and all else of the file unchanged.

The text is edited, parsed again, and written only if the parsed values are the intended ones.
"""

import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from lipservo.settings.settings import FaceSettings, parse_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.errors import UserError
from lipsync.output_file import write_whole

#: From the top of the file down, such as ("servos", "jaw", "min_us").
Place = tuple[str, ...]
#: A key that needs no quotes, unless it means something to YAML, as `on` does.
_PLAIN_KEY: Final = re.compile("[a-z][a-z0-9_]*")


class ChangedMeanwhileError(UserError):
    """Error for a file that was changed after it was read, and so is not overwritten."""


@dataclass(frozen=True, slots=True)
class EditedYaml:
    """A face YAML with changed values, checked, and not written yet. before: the file's text."""

    path: Path
    before: str
    text: str

    def write(self) -> None:
        """Write the file, whole or not at all.

        Raises ChangedMeanwhileError if it was changed since it was read; SettingsError,
        OutputError.
        """
        with _locked_folder(self.path):
            if read_face_text(self.path) != self.before:
                raise ChangedMeanwhileError(f"{self.path.name}: was changed meanwhile; try again")
            write_whole(self.path, self.text.encode())


def read_face_text(path: Path) -> str:
    """Return the text of a YAML file. Raises SettingsError if it cannot be read or is not UTF-8."""
    try:
        return path.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path.name}: cannot be read: {error}") from error


def edited(path: Path, values: Mapping[Place, float | str]) -> EditedYaml:
    """Return the face YAML at `path` with `values` set in it, not written yet.

    values: numbers or texts by their place, a path of keys. Raises SettingsError if the file is no
    face YAML or would not be one with `values`, and UserError if its form leaves no safe position
    for them.
    """
    before = read_face_text(path)
    wanted = _plain_mapping(parse_face(before, path.name))
    text: str | None = before
    for place, value in values.items():
        if _value_at(wanted, place) == value:
            continue
        yaml_text = _yaml_text(value)
        text = None if text is None else _with_value(text, place, yaml_text)
        _set_value(wanted, place, value if isinstance(value, str) else float(yaml_text))
    # The new text must parse to the old values but for those that were set.
    if text is None or not _is_yaml(text) or _plain_mapping(parse_face(text, path.name)) != wanted:
        lines = "; ".join(lines_by_hand(*each).replace("\n", " / ") for each in values.items())
        raise UserError(f"{path.name}: cannot be edited safely; add these lines by hand: {lines}")
    return EditedYaml(path, before, text)


def lines_by_hand(place: Place, value: float | str) -> str:
    """Return the YAML lines that a person should add for the value at `place` (a path of keys)."""
    return _block(list(place), _yaml_text(value), 0, "\n")


def _yaml_text(value: float | str) -> str:
    """Return a value as YAML text: words in quotes if they would parse as another type without."""
    if not isinstance(value, str):
        return f"{value:g}"
    try:
        is_plain = yaml.safe_load(f"a: {value}") == {"a": value}
    except yaml.YAMLError:
        is_plain = False
    return value if is_plain else json.dumps(value, ensure_ascii=False)


def _plain_mapping(face: FaceSettings) -> dict[str, Any]:
    return face.model_dump(exclude_none=True)


def _value_at(node: Any, place: Place) -> Any:
    """Return the value at `place`, a path of keys, in nested mappings; None if a key is missing."""
    for key in place:
        node = node.get(key) if isinstance(node, dict) else None
    return node


def _set_value(node: dict[str, Any], place: Place, value: float | str) -> None:
    """Set the value at `place`, a path of keys, in nested mappings; these are copied on the way."""
    *sections, key = place
    for each in sections:
        node[each] = dict(node.get(each) or {})
        node = node[each]
    node[key] = value


def _is_yaml(text: str) -> bool:
    try:
        return isinstance(yaml.compose(text, Loader=yaml.SafeLoader), yaml.MappingNode)
    except yaml.YAMLError:
        return False


def _with_value(text: str, place: Place, value: str) -> str | None:
    """Return the text with `value` at `place`, a path of keys, replaced or added.

    value: as YAML text. None: the text's form leaves no safe position.
    """
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    if not isinstance(node, yaml.MappingNode) or node.flow_style:
        return None
    eol = "\r\n" if "\r\n" in text else "\n"
    missing = list(place)
    # Go down from the top as far as the keys exist; those left over are missing.
    while missing and isinstance(node, yaml.MappingNode):
        child = next((each for key, each in node.value if key.value == missing[0]), None)
        if child is None:
            break
        node, _ = child, missing.pop(0)
    if not missing:
        if not isinstance(node, yaml.ScalarNode):
            return None
        return text[: node.start_mark.index] + value + text[node.end_mark.index :]
    if not isinstance(node, yaml.MappingNode):
        return None
    # No key exists: a new block at the end of the file.
    if len(missing) == len(place):
        last_eol = "" if text.endswith("\n") else eol
        return f"{text}{last_eol}{eol}{_block(missing, value, 0, eol)}{eol}"
    start = node.start_mark.index
    if node.flow_style:
        comma = ", " if node.value else ""
        return f"{text[: start + 1]}{_flow(missing, value)}{comma}{text[start + 1 :]}"
    # An anchor stands before the first key of its mapping.
    start, column = node.value[0][0].start_mark.index, node.value[0][0].start_mark.column
    return f"{text[:start]}{_block(missing, value, column, eol)}{eol}{' ' * column}{text[start:]}"


def _block(keys: list[str], value: str, column: int, eol: str) -> str:
    """Return nested YAML lines for keys and a value, at indent `column`, joined by `eol`.

    The first line has no indent.
    """
    lines = [f"{' ' * (column + 2 * n)}{_key(each)}:" for n, each in enumerate(keys)]
    return f"{eol.join(lines).lstrip(' ')} {value}"


def _flow(keys: list[str], value: str) -> str:
    """Return nested keys and a value as one line of YAML, `a: {b: {c: value}}`."""
    return f"{''.join(f'{_key(each)}: {{' for each in keys[:-1])}{_key(keys[-1])}: {value}" + (
        "}" * (len(keys) - 1)
    )


def _key(name: str) -> str:
    # A JSON text is a YAML text, whatever stands in a device's name.
    is_plain = _PLAIN_KEY.fullmatch(name) and isinstance(yaml.safe_load(name), str)
    return name if is_plain else json.dumps(name, ensure_ascii=False)


@contextmanager
def _locked_folder(path: Path) -> Iterator[None]:
    """Lock the folder of `path`, so that no other program of lipservo writes a face YAML in it."""
    import fcntl

    try:
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise SettingsError(f"{path.name}: cannot be read: {error}") from error
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)
