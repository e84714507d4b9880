"""The offset of a loudspeaker, written into a face YAML; everything else of the file stays."""

import json
from pathlib import Path

import yaml

from lipservo.settings.settings import FaceSettings, parse_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.errors import UserError
from lipsync.output_file import write_whole


def offset_lines(device: str, offset_ms: float) -> str:
    """What a person would write."""
    return f"sound:\n  output_offset_ms:\n    {_entry(device, offset_ms)}\n"


def store_output_offset(path: Path, device: str, offset_ms: float) -> None:
    """Put the offset of a device, by its name, into the face YAML at `path`.

    Whole or not at all; comments and order stay. Raises SettingsError for a file that is no face
    YAML, and UserError, with the lines to write by hand, for one that is written so that there is
    no safe place for it.
    """
    try:
        text = path.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path.name}: cannot be read: {error}") from error
    before = parse_face(text, path.name)
    changed = with_output_offset(text, device, offset_ms)
    try:
        after = None if changed is None else parse_face(changed, path.name)
    except SettingsError:
        after = None
    if changed is None or after != _with_offset(before, device, offset_ms):
        lines = offset_lines(device, offset_ms).rstrip().replace("\n", " / ")
        raise UserError(f"{path.name}: no safe place to write it; add by hand: {lines}")
    write_whole(path, changed.encode())


def with_output_offset(text: str, device: str, offset_ms: float) -> str | None:
    """The text of a face YAML with that offset in it; None where there is no place for it.

    Only places lines; whether the result means what it should is for the caller to check.
    """
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    if not isinstance(root, yaml.MappingNode) or root.flow_style:
        return None
    end = "\r\n" if "\r\n" in text else "\n"
    sound = _value(root, "sound")
    if sound is None:
        last = "" if text.endswith("\n") else end
        return f"{text}{last}{end}{offset_lines(device, offset_ms).replace(chr(10), end)}"
    offsets = _value(sound, "output_offset_ms")
    entry = _entry(device, offset_ms)
    if offsets is None:
        inner = " " * (sound.start_mark.column + 2) + entry
        return _put_first(text, sound, f"output_offset_ms:{end}{inner}", entry, end)
    known = _value(offsets, device)
    if known is not None:
        return text[: known.start_mark.index] + f"{offset_ms:g}" + text[known.end_mark.index :]
    return _put_first(text, offsets, entry, None, end)


def _put_first(text: str, node: yaml.Node, block: str, inside: str | None, end: str) -> str | None:
    """A new first entry of a mapping. inside: in a mapping of one line, in its own braces."""
    at = node.start_mark.index
    if not isinstance(node, yaml.MappingNode):
        return None
    if not node.flow_style:
        return f"{text[:at]}{block}{end}{' ' * node.start_mark.column}{text[at:]}"
    entry = block if inside is None else f"output_offset_ms: {{{inside}}}"
    comma = ", " if node.value else ""
    return f"{text[: at + 1]}{entry}{comma}{text[at + 1 :]}"


def _value(node: yaml.Node, key: str) -> yaml.Node | None:
    entries = node.value if isinstance(node, yaml.MappingNode) else []
    return next((value for name, value in entries if name.value == key), None)


def _entry(device: str, offset_ms: float) -> str:
    # A JSON text is a YAML text, whatever stands in a device's name.
    return f"{json.dumps(device, ensure_ascii=False)}: {offset_ms:g}"


def _with_offset(face: FaceSettings, device: str, offset_ms: float) -> FaceSettings:
    offsets = {**face.sound.output_offset_ms, device: float(f"{offset_ms:g}")}
    sound = face.sound.model_copy(update={"output_offset_ms": offsets})
    return face.model_copy(update={"sound": sound})
