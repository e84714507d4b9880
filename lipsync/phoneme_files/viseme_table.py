"""Which phone of ours moves the mouth for a viseme of somebody else's: visemes.yaml."""

from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType

import yaml


@cache
def viseme_rows(viseme_set: str) -> Mapping[str, tuple[str, str]]:
    """(phone, reason) by viseme, of the set `polly`, `azure` or `ovr`; numbers as text."""
    text = files("lipsync.phoneme_files").joinpath("visemes.yaml").read_text("utf-8")
    rows = yaml.safe_load(text)[viseme_set]
    return MappingProxyType({str(viseme): (row[0], row[1]) for viseme, row in rows.items()})
