"""The ports of a face as one text: `/dev/ttyUSB0`, or for several buses `neck=...,lips=...`."""

import re
from collections.abc import Mapping
from typing import Final

#: The name of a bus in a face's YAML: one word, as a joint's.
BUS_NAME: Final = r"^[a-z][a-z0-9_]*$"
_NAMED: Final = re.compile(r"([a-z][a-z0-9_]*)=(.+)", re.DOTALL)


def ports_text(ports: Mapping[str, str]) -> str | None:
    """Return ports, by bus name, as the text `name=port,...`; None: `ports` is empty."""
    return ",".join(f"{name}={port}" for name, port in ports.items()) or None


def named_ports(text: str) -> dict[str, str] | None:
    """Parse `name=port,...` into ports by bus name; None: not every part of `text` has a name."""
    found = [_NAMED.fullmatch(each) for each in text.split(",")]
    if not all(found):
        return None
    return {each[1]: each[2] for each in found if each is not None}


def ports_in(text: str) -> list[str]:
    """Return the ports in a text such as `/dev/ttyUSB0` or `a=/dev/ttyUSB0,b=/dev/ttyUSB1`."""
    named = named_ports(text)
    return [text] if named is None else list(named.values())
