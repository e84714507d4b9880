"""Named weights over time, and the files that hold them: JSON lines and CSV."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

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
    """kind: arkit or ovr. names: (k,). times_s: (n,), ascending. values: (n, k), from 0 to 1."""

    kind: str
    rate_hz: float
    names: tuple[str, ...]
    times_s: Array
    values: Array


def frame_times_s(duration_s: float, rate_hz: float) -> Array:
    """(n,), the times of frames from 0 to the end of the sound, which none lies beyond."""
    return np.arange(int(np.floor(duration_s * rate_hz + 1e-9)) + 1) / rate_hz


def track_lines(track: WeightTrack) -> str:
    """JSON lines: a header with the names, then {"time_s", "values"} a frame."""
    header = {
        "lipservo_export": TRACK_VERSION,
        "kind": track.kind,
        "rate_hz": track.rate_hz,
        "names": track.names,
    }
    rows = (
        json.dumps({"time_s": round(float(time_s), 6), "values": _rounded(values)})
        for time_s, values in zip(track.times_s, track.values, strict=True)
    )
    return "\n".join([json.dumps(header), *rows]) + "\n"


def track_csv(track: WeightTrack) -> str:
    """A row a frame: time_s, then the weights."""
    rows = (
        [f"{time_s:.6f}", *_fixed(values)]
        for time_s, values in zip(track.times_s, track.values, strict=True)
    )
    return _csv([["time_s", *track.names], *rows])


def live_link_csv(track: WeightTrack) -> str:
    """ARKit's 52 as the Live Link Face app writes a take.

    Timecode is HH:MM:SS:FF.fff of sound time, FF counting whole frames at the track's rate, which
    has to be whole; head and eyes are not turned.
    """
    still = ["0"] * len(_ROTATIONS)
    rows = (
        [_timecode(float(time_s), track.rate_hz), str(LIVE_LINK_COUNT), *_fixed(values), *still]
        for time_s, values in zip(track.times_s, track.values, strict=True)
    )
    names = (name[0].upper() + name[1:] for name in track.names)
    return _csv([["Timecode", "BlendShapeCount", *names, *_ROTATIONS], *rows])


def _timecode(time_s: float, rate_hz: float) -> str:
    """Raises ValueError for a rate that is not whole: there would be parts of frames a second."""
    if rate_hz != round(rate_hz):
        raise ValueError(f"a timecode needs a whole number of frames a second, not {rate_hz}")
    thousandths = round(time_s * rate_hz * 1000)
    seconds, rest = divmod(thousandths, round(rate_hz) * 1000)
    minutes, second = divmod(seconds, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}:{minute:02d}:{second:02d}:{rest // 1000:02d}.{rest % 1000:03d}"


def _rounded(values: Array) -> list[float]:
    return [round(float(value), _DECIMALS) for value in values]


def _fixed(values: Array) -> list[str]:
    return [f"{value:.{_DECIMALS}f}" for value in values]


def _csv(rows: Sequence[Sequence[str]]) -> str:
    return "".join(",".join(row) + "\n" for row in rows)
