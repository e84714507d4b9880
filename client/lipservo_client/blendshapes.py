"""Blendshapes of a face, ARKit's 52 or Azure's 55, as visemes: the nearest mouth, frame by frame.

Weights describe how a face looks, not which phoneme is spoken, and every rig has its own gains.
Four measures of the mouth are computed from the weights that speech moves, and the phone with the
nearest mouth is that of the frame. Names and their meaning: Apple,
"ARFaceAnchor.BlendShapeLocation"; the order of lists, and their 60 Hz:
learn.microsoft.com/azure/ai-services/speech-service/how-to-speech-synthesis-viseme, which is that
of Live Link Face too.
"""

import reprlib
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Final

#: Places in a list of 52 or 55 weights.
_PLACES: Final = {
    "jawopen": 17, "mouthclose": 18, "mouthfunnel": 19, "mouthpucker": 20, "mouthsmileleft": 23,
    "mouthsmileright": 24, "mouthstretchleft": 29, "mouthstretchright": 30, "mouthrolllower": 31,
    "mouthlowerdownleft": 37, "mouthlowerdownright": 38, "mouthupperupleft": 39,
    "mouthupperupright": 40,
}  # fmt: skip
_LIST_LENGTHS: Final = (52, 55)
#: Of Azure's frames, and where nothing else is said.
DEFAULT_RATE_HZ: Final = 60.0
#: (opening, rounding, spreading, lower lip drawn in), each from 0 to about 1, of a phone's mouth.
#: Chosen by what the names mean, on no rig.
_MOUTHS: Final = {
    "P": (0.0, 0.0, 0.0, 0.0),
    "F": (0.1, 0.0, 0.1, 0.5),
    "T": (0.15, 0.0, 0.2, 0.0),
    "IY": (0.2, 0.0, 0.6, 0.0),
    "EH": (0.4, 0.0, 0.3, 0.0),
    "AH": (0.45, 0.05, 0.0, 0.0),
    "AA": (0.8, 0.05, 0.1, 0.0),
    "AO": (0.6, 0.4, 0.0, 0.0),
    "OW": (0.35, 0.6, 0.0, 0.0),
    "UW": (0.15, 0.8, 0.0, 0.0),
    "SH": (0.25, 0.4, 0.0, 0.0),
}  # fmt: skip
#: Lips that stay shut for longer close, rest, and close again before they part.
_LONGEST_CLOSURE_S, _CLOSED_S = 0.3, 0.1
#: A mouth that is passed through is no viseme; a closure always is.
_SHORTEST_S: Final = 0.035


def mouth_rows(
    frames: Sequence[object], rate_hz: float, first: int = 0
) -> list[tuple[str, float, float]]:
    """Return rows (phone, start_s, end_s) of `frames`: 52 or 55 weights each, or weights by name.

    first: the number of the first frame in its stream, whose frames number rate_hz a second. Raises
    ValueError for a malformed frame.
    """
    # A row for each run of frames with one phone; but a long closure becomes a closure, silence and
    # a closure, and a short run of another phone is joined to the row before.
    rows: list[tuple[str, float, float]] = []
    number = first
    for phone, group in groupby(map(_nearest_phone, map(_mouth_weights, frames))):
        start_s = number / rate_hz
        number += sum(1 for _ in group)
        end_s = number / rate_hz
        if phone == "P" and end_s - start_s > _LONGEST_CLOSURE_S:
            shut_s, parting_s = start_s + _CLOSED_S, end_s - _CLOSED_S
            rows += [("P", start_s, shut_s), ("SIL", shut_s, parting_s), ("P", parting_s, end_s)]
        elif phone != "P" and end_s - start_s < _SHORTEST_S and rows and rows[-1][0] != "P":
            rows[-1] = (*rows[-1][:2], end_s)
        else:
            rows.append((phone, start_s, end_s))
    return rows


def _mouth_weights(frame: object) -> dict[str, float]:
    """Return the weights that speech moves, by lower-case name; 0 if missing. Raises ValueError."""
    if isinstance(frame, list) and len(frame) in _LIST_LENGTHS:
        given = {name: frame[place] for name, place in _PLACES.items()}
    elif isinstance(frame, Mapping):
        given = {str(name).lower(): weight for name, weight in frame.items()}
    else:
        raise ValueError("a frame must have 52 or 55 weights, or weights by name")
    named = {name: given.get(name, 0.0) for name in _PLACES}
    for name, weight in named.items():
        if isinstance(weight, bool) or not isinstance(weight, int | float) or not 0 <= weight <= 2:
            raise ValueError(f"weight {reprlib.repr(weight)} of {name} must be 0 to 1")
    return named


def _nearest_phone(weights: Mapping[str, float]) -> str:
    """Return the phone in `_MOUTHS` whose four measures are nearest to those of the weights."""

    def mean(*names: str) -> float:
        return sum(weights[name] for name in names) / len(names)

    lips = mean(
        "mouthlowerdownleft", "mouthlowerdownright", "mouthupperupleft", "mouthupperupright"
    )
    # Opening, rounding, spreading, lower lip drawn in, as in `_MOUTHS`.
    mouth = (
        max(0.0, mean("jawopen") - mean("mouthclose")) + lips,
        max(mean("mouthfunnel"), mean("mouthpucker")),
        mean("mouthsmileleft", "mouthsmileright", "mouthstretchleft", "mouthstretchright"),
        mean("mouthrolllower"),
    )
    return min(
        _MOUTHS,
        key=lambda phone: sum((a - b) ** 2 for a, b in zip(mouth, _MOUTHS[phone], strict=True)),
    )
