"""Where phones that were found go: a TextGrid or JSON, by the ending of the file's name."""

import json
from collections.abc import Iterable
from pathlib import Path

from lipsync.errors import UserError
from lipsync.output_file import check_output, write_whole
from lipsync.textgrid import Interval, is_textgrid, write_tiers

Tiers = dict[str, tuple[Interval, ...]]

_TEXTGRID, _JSON = ".textgrid", ".json"


class PhoneFileError(UserError):
    """A name says no format that is known here; the message is one line."""


def check_phone_file(path: Path, inputs: Iterable[Path | None]) -> None:
    """Before the work: refuse a name without a format, and what `check_output` refuses."""
    if path.suffix.lower() == _TEXTGRID:
        check_output(path, replaces=is_textgrid, kind="TextGrid", inputs=inputs)
    elif path.suffix.lower() == _JSON:
        check_output(path, replaces=_is_tiers, kind="JSON of phones", inputs=inputs)
    else:
        raise PhoneFileError(
            f"{path}: the ending says how to write it, and this one says nothing; "
            "name it .TextGrid (Praat) or .json"
        )


def write_phone_file(path: Path, tiers: Tiers) -> None:
    """Write interval tiers: a TextGrid, or {"phones": [[label, start_s, end_s], ...], ...}."""
    if path.suffix.lower() == _TEXTGRID:
        write_tiers(path, tiers)
    else:
        write_whole(path, json.dumps(tiers) + "\n")


def _is_tiers(head: bytes) -> bool:
    return head.startswith((b'{"phones": ', b'{"words": '))
