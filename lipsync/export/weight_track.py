"""Named weights over time: in files (JSON lines, CSV) and in datagrams (Live Link Face, OSC).

Live Link Face is an app of Epic Games, for a face of 52 blendshapes. Epic publishes no
specification. The layout is that which public receivers and senders agree on (PyLiveLinkFace, MIT
licence, is one, and decodes these in our tests): big-endian; version 6 as a byte; the device's id
and the subject's name, each with its length in 32 bits before it; the time as frame (32 bits), part
of a frame (float), rate as numerator and denominator (32 bits each); the count 61 as a byte; 61
floats: the blendshapes, then yaw, pitch, roll of head, left and right eye.

Open Sound Control 1.0, https://opensoundcontrol.stanford.edu/spec-1_0.html. VMC protocol,
https://protocol.vmc.info/english: `/VMC/Ext/Blend/Val` name value, a message for each shape, then
`/VMC/Ext/Blend/Apply`.
"""

import json
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain

import numpy as np

from lipsync.arrays import Array

#: Of the JSON lines; raised whenever their meaning changes.
TRACK_VERSION = 1
_DECIMALS = 5
#: Live Link Face writes so many columns: 52 blendshapes, and head and eyes turned.
LIVE_LINK_COUNT = 61
_ROTATIONS = ("HeadYaw", "HeadPitch", "HeadRoll", "LeftEyeYaw", "LeftEyePitch", "LeftEyeRoll",
              "RightEyeYaw", "RightEyePitch", "RightEyeRoll")  # fmt: skip


@dataclass(frozen=True, slots=True)
class WeightTrack:
    """Named weights over time at a frame rate, for an avatar.

    kind: arkit or ovr. rate_hz: frames a second. names: (k,), of the weights. times_s: (n,),
    ascending. values: n rows of (k,), from 0 to 1, which may be computed as they are written.
    """

    kind: str
    rate_hz: float
    names: tuple[str, ...]
    times_s: Array
    values: Iterable[Array]


def frame_times_s(duration_s: float, rate_hz: float) -> Array:
    """Return the times of frames from 0 to the end of the sound; none is later than the end.

    Parameters
    ----------
    duration_s : float
        Length of the sound.
    rate_hz : float
        Frames a second.

    Returns
    -------
    Array
        (n,) s from 0 on.
    """
    return np.arange(int(np.floor(duration_s * rate_hz + 1e-9)) + 1) / rate_hz


def track_lines(track: WeightTrack) -> Iterator[str]:
    """Yield a track as JSON lines: a header with names, then {"time_s", "values"} per frame."""
    header = {
        "lipservo_export": TRACK_VERSION,
        "kind": track.kind,
        "rate_hz": track.rate_hz,
        "names": track.names,
    }
    yield json.dumps(header) + "\n"
    for time_s, values in zip(track.times_s, track.values, strict=True):
        rounded = [round(float(value), _DECIMALS) for value in values]
        yield json.dumps({"time_s": round(float(time_s), 6), "values": rounded}) + "\n"


def track_csv(track: WeightTrack) -> Iterator[str]:
    """Yield a track as CSV: a header, then a row per frame with time_s and the weights."""
    rows = (
        [f"{time_s:.6f}", *_fixed(values)]
        for time_s, values in zip(track.times_s, track.values, strict=True)
    )
    return _csv_lines(chain([["time_s", *track.names]], rows))


def live_link_csv(track: WeightTrack) -> Iterator[str]:
    """Yield a track of ARKit's 52 weights as CSV in the format of the Live Link Face app.

    Timecode is HH:MM:SS:FF.fff of sound time, FF counting whole frames at the track's rate, which
    has to be whole, else ValueError; the angles of head and eyes are 0.
    """
    still = ["0"] * len(_ROTATIONS)
    rows = (
        [_timecode(float(time_s), track.rate_hz), str(LIVE_LINK_COUNT), *_fixed(values), *still]
        for time_s, values in zip(track.times_s, track.values, strict=True)
    )
    names = (name[0].upper() + name[1:] for name in track.names)
    return _csv_lines(chain([["Timecode", "BlendShapeCount", *names, *_ROTATIONS]], rows))


def _timecode(time_s: float, rate_hz: float) -> str:
    """Return a sound time as HH:MM:SS:FF.fff. Raises ValueError for a rate that is not whole."""
    if rate_hz != round(rate_hz):
        raise ValueError(f"a timecode needs whole frames per second, not {rate_hz} Hz")
    thousandths = round(time_s * rate_hz * 1000)
    # The rest of a second, in thousandths of a frame.
    seconds, rest = divmod(thousandths, round(rate_hz) * 1000)
    minutes, second = divmod(seconds, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}:{minute:02d}:{second:02d}:{rest // 1000:02d}.{rest % 1000:03d}"


def _fixed(values: Array) -> list[str]:
    return [f"{value:.{_DECIMALS}f}" for value in values]


def _csv_lines(rows: Iterable[Sequence[str]]) -> Iterator[str]:
    return (",".join(row) + "\n" for row in rows)


_LIVE_LINK_VERSION = 6
_N_FLOATS, _N_ROTATIONS = 61, 9
_RATE_HZ = 60
#: Any 36 characters, as a UUID is written; receivers tell devices apart by it.
_DEVICE_ID = b"6c697073-6572-766f-8000-000000000001"


def live_link_packet(values: Array, subject: str, time_s: float) -> bytes:
    """Return the datagram of one frame for Live Link Face; the angles of head and eyes are 0.

    Parameters
    ----------
    values : Array
        (52,) weights, in the order of `ARKIT_NAMES`.
    subject : str
        Name of the face, ASCII.
    time_s : float
        Sound time; before the first sound counts as 0.

    Returns
    -------
    bytes
        One UDP datagram.
    """
    frame, fraction = divmod(max(time_s, 0.0) * _RATE_HZ, 1.0)
    name = subject.encode("ascii")
    # The layout is described at the top of this module.
    return b"".join(
        (
            struct.pack(">Bi", _LIVE_LINK_VERSION, len(_DEVICE_ID)),
            _DEVICE_ID,
            struct.pack(">i", len(name)),
            name,
            # 32 bits hold 414 days at 60 a second; then it begins anew.
            struct.pack(">ifii", int(frame) % 2**31, fraction, _RATE_HZ, 1),
            struct.pack(f">B{_N_FLOATS}f", _N_FLOATS, *values.tolist(), *([0.0] * _N_ROTATIONS)),
        )
    )


_VALUE_ADDRESS, _APPLY_ADDRESS = "/VMC/Ext/Blend/Val", "/VMC/Ext/Blend/Apply"
#: "Immediately", section "OSC Bundles".
_BUNDLE_HEAD = b"#bundle\x00" + struct.pack(">Q", 1)
#: A datagram of this size passes an Ethernet unbroken (1500 bytes less IPv6's and UDP's headers).
MOST_BYTES = 1452


def osc_message(address: str, *arguments: str | float) -> bytes:
    """Return one OSC message to `address`; strings are encoded as `s`, numbers as `f` (32 bits)."""
    tags = "," + "".join("s" if isinstance(each, str) else "f" for each in arguments)
    values = (
        _padded(each) if isinstance(each, str) else struct.pack(">f", each) for each in arguments
    )
    return b"".join((_padded(address), _padded(tags), *values))


def vmc_packets(shapes: Iterable[tuple[str, float]]) -> list[bytes]:
    """Return OSC datagrams that set blendshapes by name; the last one ends with the Apply message.

    shapes: (name, weight) each. All are in one datagram, unless that would exceed 1452 bytes.
    """
    packets = [_BUNDLE_HEAD]
    messages = [osc_message(_VALUE_ADDRESS, name, value) for name, value in shapes]
    for message in (*messages, osc_message(_APPLY_ADDRESS)):
        # In an OSC bundle each message comes after its size.
        element = struct.pack(">i", len(message)) + message
        if len(packets[-1]) + len(element) > MOST_BYTES:
            packets.append(_BUNDLE_HEAD)
        packets[-1] += element
    return packets


@lru_cache(maxsize=256)  # the same few names, 60 times a second
def _padded(text: str) -> bytes:
    """Return ASCII text as an OSC string: one to four zero bytes fill it up to a multiple of 4."""
    encoded = text.encode("ascii")
    return encoded + b"\x00" * (4 - len(encoded) % 4)
