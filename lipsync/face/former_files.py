"""Model files of version 3: the same arrays under other names, all side by side.

Their points were always the 47 named markers, told by name.
"""

from collections.abc import Iterable, Sequence

from lipsync.markers import LAYOUTS, PointLayout

FORMER_VERSION = 3

#: What version 3 called an array, by its name today.
_FORMER_NAMES = {
    "face/mean_mm": "mean_mm",
    "face/basis": "basis",
    "face/head_reference_mm": "head_reference_mm",
    "face/rest": "rest",
    "face/covariance": "covariance",
    "face/labiodental_gap_mm": "labiodental_gap_mm",
    "face/tightest_s": "tightest_s",
    "animphos/samples": "animphos",
    "animphos/successor_starts": "successor_starts",
    "animphos/successors": "successors",
    "animphos/phoneme_starts": "phoneme_starts",
    "animphos/phoneme_animphos": "phoneme_animphos",
    "baselines/centres": "centres",
    "baselines/counts": "counts",
    "baselines/dominance": "dominance",
    "baselines/regression": "regression",
}
_FORMER_PREFIX, _PREFIX = "expectation_", "expectation/"


def former_members(stored: Iterable[str]) -> dict[str, str]:
    """What an array is called today, and what a file of version 3 calls it."""
    names = set(stored)
    found = {today: former for today, former in _FORMER_NAMES.items() if former in names}
    for name in sorted(names):
        if name.startswith(_FORMER_PREFIX):
            found[_PREFIX + name.removeprefix(_FORMER_PREFIX)] = name
    return found


def former_layout(marker_names: Sequence[str]) -> PointLayout:
    """The layout that has these points. Raises ValueError where none has."""
    for layout in LAYOUTS.values():
        if layout.names == tuple(marker_names):
            return layout
    raise ValueError("its points are none of a known layout")
