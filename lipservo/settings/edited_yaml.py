"""Values written into a face YAML: comments, order and everything else of the file stay.

The text is changed in place, read back, and written only when it then says what was meant.
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
    """The file is not any more what it was when it was read."""


@dataclass(frozen=True, slots=True)
class EditedYaml:
    """A face YAML with other numbers, checked, and not written yet."""

    path: Path
    before: str
    text: str

    def write(self) -> None:
        """Whole or not at all. Raises ChangedMeanwhileError, OutputError."""
        with _alone(self.path):
            if read_face_text(self.path) != self.before:
                raise ChangedMeanwhileError(f"{self.path.name}: was changed meanwhile; try again")
            write_whole(self.path, self.text.encode())


def read_face_text(path: Path) -> str:
    """The YAML as text. Raises SettingsError."""
    try:
        return path.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path.name}: cannot be read: {error}") from error


def edited(path: Path, values: Mapping[Place, float | str]) -> EditedYaml:
    """The file at `path` with these numbers or words in it.

    Raises SettingsError for a file that is no face YAML or would be none with them, and UserError
    for one that is written so that there is no safe place.
    """
    before = read_face_text(path)
    wanted = _plain_mapping(parse_face(before, path.name))
    text: str | None = before
    for place, value in values.items():
        if _at(wanted, place) == value:
            continue
        written = _written(value)
        text = None if text is None else _with_value(text, place, written)
        _put(wanted, place, value if isinstance(value, str) else float(written))
    if text is None or not _is_yaml(text) or _plain_mapping(parse_face(text, path.name)) != wanted:
        lines = "; ".join(lines_by_hand(*each).replace("\n", " / ") for each in values.items())
        raise UserError(f"{path.name}: no safe place to write it; add by hand: {lines}")
    return EditedYaml(path, before, text)


def lines_by_hand(place: Place, value: float | str) -> str:
    """Return the lines that a person should add to the YAML."""
    return _block(list(place), _written(value), 0, "\n")


def _written(value: float | str) -> str:
    """As it stands in YAML: words in quotes where they would mean something else without."""
    if not isinstance(value, str):
        return f"{value:g}"
    try:
        is_plain = yaml.safe_load(f"a: {value}") == {"a": value}
    except yaml.YAMLError:
        is_plain = False
    return value if is_plain else json.dumps(value, ensure_ascii=False)


def _plain_mapping(face: FaceSettings) -> dict[str, Any]:
    return face.model_dump(exclude_none=True)


def _at(node: Any, place: Place) -> Any:
    for key in place:
        node = node.get(key) if isinstance(node, dict) else None
    return node


def _put(node: dict[str, Any], place: Place, value: float | str) -> None:
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
    """The text with a number at a place, which is made where it is absent; None: it cannot be."""
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    if not isinstance(node, yaml.MappingNode) or node.flow_style:
        return None
    end = "\r\n" if "\r\n" in text else "\n"
    left = list(place)
    while left and isinstance(node, yaml.MappingNode):
        found = next((each for key, each in node.value if key.value == left[0]), None)
        if found is None:
            break
        node, _ = found, left.pop(0)
    if not left:
        if not isinstance(node, yaml.ScalarNode):
            return None
        return text[: node.start_mark.index] + value + text[node.end_mark.index :]
    if not isinstance(node, yaml.MappingNode):
        return None
    if len(left) == len(place):
        last = "" if text.endswith("\n") else end
        return f"{text}{last}{end}{_block(left, value, 0, end)}{end}"
    at = node.start_mark.index
    if node.flow_style:
        comma = ", " if node.value else ""
        return f"{text[: at + 1]}{_flow(left, value)}{comma}{text[at + 1 :]}"
    # An anchor stands before the first key of its mapping.
    at, column = node.value[0][0].start_mark.index, node.value[0][0].start_mark.column
    return f"{text[:at]}{_block(left, value, column, end)}{end}{' ' * column}{text[at:]}"


def _block(keys: list[str], value: str, column: int, end: str) -> str:
    """What a person would write; the first line without its indent."""
    lines = [f"{' ' * (column + 2 * n)}{_key(each)}:" for n, each in enumerate(keys)]
    return f"{end.join(lines).lstrip(' ')} {value}"


def _flow(keys: list[str], value: str) -> str:
    return f"{''.join(f'{_key(each)}: {{' for each in keys[:-1])}{_key(keys[-1])}: {value}" + (
        "}" * (len(keys) - 1)
    )


def _key(name: str) -> str:
    # A JSON text is a YAML text, whatever stands in a device's name.
    is_plain = _PLAIN_KEY.fullmatch(name) and isinstance(yaml.safe_load(name), str)
    return name if is_plain else json.dumps(name, ensure_ascii=False)


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """No other program of ours writes a face YAML in this folder meanwhile."""
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
