"""The datagrams of Live Link Face, the app of Epic Games, for a face of 52 blendshapes.

Epic publishes no specification. The layout is that which public receivers and senders agree on
(PyLiveLinkFace, MIT licence, is one, and decodes these in our tests): big-endian; version 6 as a
byte; the device's id and the subject's name, each with its length in 32 bits before it; the time as
frame (32 bits), part of a frame (float), rate as numerator and denominator (32 bits each); the
count 61 as a byte; 61 floats: the blendshapes, then yaw, pitch, roll of head, left and right eye.
"""

import struct

from lipsync.arrays import Array

#: The port that Unreal Engine listens on.
LIVE_LINK_PORT = 11111
_VERSION = 6
_N_FLOATS, _N_ROTATIONS = 61, 9
_RATE_HZ = 60
#: Any 36 characters, as a UUID is written; receivers tell devices apart by it.
_DEVICE_ID = b"6c697073-6572-766f-8000-000000000001"


def live_link_packet(values: Array, subject: str, time_s: float) -> bytes:
    """One frame. values: (52,), in the order of `ARKIT_NAMES`; head and eyes are not turned.

    time_s: sound time; before the first sound counts as 0.
    """
    frame, part = divmod(max(time_s, 0.0) * _RATE_HZ, 1.0)
    name = subject.encode("ascii")
    return b"".join(
        (
            struct.pack(">Bi", _VERSION, len(_DEVICE_ID)),
            _DEVICE_ID,
            struct.pack(">i", len(name)),
            name,
            # 32 bits hold 414 days at 60 a second; then it begins anew.
            struct.pack(">ifii", int(frame) % 2**31, part, _RATE_HZ, 1),
            struct.pack(f">B{_N_FLOATS}f", _N_FLOATS, *values.tolist(), *([0.0] * _N_ROTATIONS)),
        )
    )
