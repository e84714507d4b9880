"""A checksum over what a calibration file says: a digit that changed on the way is noticed.

Comments and spaces do not count, and neither do trims, which a person may write by hand.
"""

import hashlib
import json
from typing import Final

import yaml

from calibration.calibration import CalibrationError

#: libyaml's reader where PyYAML has it: ten times as fast.
_SAFE_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_KEY: Final = "checksum"
#: What a hand may change.
_NOT_COUNTED: Final = (_KEY, "trim")


def with_checksum(text: str) -> str:
    """The file's text with a last line that holds its checksum."""
    checksum = _checksum(yaml.load(text, Loader=_SAFE_LOADER))
    return f'{text}{_KEY}: "{checksum}"  # over all but trims, which may be changed by hand\n'


def check_checksum(content: object, source: str) -> None:
    """Raises CalibrationError where a file says something else than when it was written.

    content: as parsed. A file without a checksum, as older ones are, passes.
    """
    if not isinstance(content, dict) or _KEY not in content:
        return
    if content[_KEY] != _checksum(content):
        raise CalibrationError(
            f"{source}: has changed since it was written, and not in its trims: its checksum does "
            f"not fit. Go back to a copy of it, or calibrate again; a change that is meant counts "
            f"once the line `{_KEY}:` is deleted"
        )


def _checksum(content: object) -> str:
    """16 hex digits."""
    counted = content
    if isinstance(content, dict):
        counted = {key: value for key, value in content.items() if key not in _NOT_COUNTED}
    text = json.dumps(counted, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
