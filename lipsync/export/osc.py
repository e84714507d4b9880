"""OSC messages, and the blendshapes of the VMC protocol in them.

Open Sound Control 1.0, https://opensoundcontrol.stanford.edu/spec-1_0.html. VMC protocol,
https://protocol.vmc.info/english: `/VMC/Ext/Blend/Val` name value, a message a shape, then
`/VMC/Ext/Blend/Apply`.
"""

import struct
from collections.abc import Iterable
from functools import lru_cache

_VALUE, _APPLY = "/VMC/Ext/Blend/Val", "/VMC/Ext/Blend/Apply"
#: The receivers' port in the VMC protocol.
VMC_PORT = 39539
#: "Immediately", section "OSC Bundles".
_BUNDLE_HEAD = b"#bundle\x00" + struct.pack(">Q", 1)
#: A datagram of this size passes an Ethernet unbroken (1500 bytes less IPv6's and UDP's headers).
MOST_BYTES = 1452


def osc_message(address: str, *arguments: str | float) -> bytes:
    """One message: strings as `s`, numbers as `f` (32 bits)."""
    tags = "," + "".join("s" if isinstance(each, str) else "f" for each in arguments)
    values = (
        _padded(each) if isinstance(each, str) else struct.pack(">f", each) for each in arguments
    )
    return b"".join((_padded(address), _padded(tags), *values))


def vmc_packets(shapes: Iterable[tuple[str, float]]) -> list[bytes]:
    """Datagrams that set blendshapes by name; the last one applies them. One, but for very many."""
    packets = [_BUNDLE_HEAD]
    messages = [osc_message(_VALUE, name, value) for name, value in shapes]
    for message in (*messages, osc_message(_APPLY)):
        element = struct.pack(">i", len(message)) + message
        if len(packets[-1]) + len(element) > MOST_BYTES:
            packets.append(_BUNDLE_HEAD)
        packets[-1] += element
    return packets


@lru_cache(maxsize=256)  # the same few names, 60 times a second
def _padded(text: str) -> bytes:
    """A string as OSC has it: with at least one zero byte, a multiple of four in all."""
    encoded = text.encode("ascii")
    return encoded + b"\x00" * (4 - len(encoded) % 4)
