"""Point layouts: which points of a face a model is made of, and what is known about them.

A model names its layout. Shipped are 47 named markers, the 39 of these without inner lips (as many
as Wei and Deng used), and all 478 points of the usual face mesh; a JSON file gives others, dense
meshes too. Points are numbered as in the recordings, here called landmarks.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lipsync.errors import UserError

N_LANDMARKS = 478

#: Round each lip from the corner on the speaker's right, over the upper lip.
OUTER_LIP = (
    61, 185, 40, 39, 37, 0, 267, 269, 270, 409,
    291, 375, 321, 405, 314, 17, 84, 181, 91, 146,
)  # fmt: skip
INNER_LIP = (
    78, 191, 80, 81, 82, 13, 312, 311, 310, 415,
    308, 324, 318, 402, 317, 14, 87, 178, 88, 95,
)  # fmt: skip
IRISES = tuple(range(468, 478))


#: Points of this group touch their opposite when the lips do, so their distance is the lip gap.
INNER_LIP_GROUP = "inner_lip"
OUTER_LIP_GROUP = "outer_lip"
#: Lips count as closed at this inner gap; 98 % of P closures in grid_s1 get there.
CLOSED_GAP_MM = 1.0
#: The keys that a layout's file must have.
_NEEDED = ("name", "groups", "lip_gap")


class LayoutError(UserError):
    """Error for a layout that cannot be used: which, what is wrong, and what is allowed."""


@dataclass(frozen=True)
class PointLayout:
    """The points of a face, in the order that `markers_mm` arrays use.

    groups: names and landmarks of each group, one group after the other; those with `lip` in their
    name are the lips; points of outer_lip and of inner_lip follow one another round the mouth, over
    the upper lip from the corner on the speaker's right. gap_landmarks: upper and lower point in
    the middle of the mouth, whose distance is its opening.
    """

    name: str
    groups: tuple[tuple[str, tuple[int, ...]], ...]
    gap_landmarks: tuple[int, int]

    def __post_init__(self) -> None:
        """Raise LayoutError for a landmark listed twice, or a lip gap not between two of them."""
        known = set(self.landmarks)
        if len(known) != len(self.landmarks):
            twice = next(n for n in self.landmarks if self.landmarks.count(n) > 1)
            raise LayoutError(f"layout {self.name}: landmark {twice} is listed twice")
        if self.gap_landmarks[0] == self.gap_landmarks[1]:
            raise LayoutError(f"layout {self.name}: lip_gap needs two different landmarks")
        for landmark in self.gap_landmarks:
            if landmark not in known:
                raise LayoutError(f"layout {self.name}: landmark {landmark} is in no group")

    @cached_property
    def landmarks(self) -> tuple[int, ...]:
        """The landmark number of every point, in order."""
        return tuple(n for _, numbers in self.groups for n in numbers)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The name of every point: its group and its landmark, such as `inner_lip_13`."""
        return tuple(f"{group}_{n}" for group, numbers in self.groups for n in numbers)

    @property
    def n_points(self) -> int:
        """The number of points of a face."""
        return len(self.landmarks)

    def group(self, name: str) -> tuple[int, ...]:
        """Return the indices of the points of group `name`, in its order; empty: no such group."""
        return tuple(self.landmarks.index(n) for n in dict(self.groups).get(name, ()))

    @cached_property
    def lips(self) -> tuple[int, ...]:
        """Indices of all points in groups with `lip` in their name, such as `inner_lip`, `lips`."""
        return tuple(i for name, _ in self.groups if "lip" in name for i in self.group(name))

    @cached_property
    def upper_lip(self) -> int:
        """Index, among the points, of the upper point of the lip gap."""
        return self.landmarks.index(self.gap_landmarks[0])

    @cached_property
    def lower_lip(self) -> int:
        """Index, among the points, of the lower point of the lip gap."""
        return self.landmarks.index(self.gap_landmarks[1])

    @property
    def has_inner_lips(self) -> bool:
        """Whether the points of the lip gap lie on the inner lips: 0 mm apart where these touch."""
        return {self.upper_lip, self.lower_lip} <= set(self.group(INNER_LIP_GROUP))

    def gap_vectors_mm(self, markers_mm: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the vectors from lower to upper point of the lip gap.

        Parameters
        ----------
        markers_mm : NDArray[np.floating]
            (n_frames, n_points, 3) positions in mm.

        Returns
        -------
        NDArray[np.floating]
            (n_frames, 3) mm.
        """
        return markers_mm[:, self.upper_lip] - markers_mm[:, self.lower_lip]

    def description(self) -> dict[str, object]:
        """Return the layout as a dict for JSON, from which `layout_of` makes an equal layout."""
        return {
            "name": self.name,
            "groups": {name: list(numbers) for name, numbers in self.groups},
            "lip_gap": list(self.gap_landmarks),
        }


def layout_of(description: Mapping[str, Any]) -> PointLayout:
    """Return the layout that `PointLayout.description`, or a JSON file of the same form, describes.

    Raises LayoutError for a missing entry, or a landmark that is no number or occurs twice.
    """
    missing = [key for key in _NEEDED if key not in description]
    if missing:
        raise LayoutError(f"the layout lacks {', '.join(missing)}; it has {', '.join(description)}")
    name = str(description["name"])
    try:
        groups = tuple(
            (str(group), _landmarks(numbers)) for group, numbers in description["groups"].items()
        )
        upper, lower = _landmarks(description["lip_gap"])
    except (AttributeError, TypeError, ValueError) as error:
        raise LayoutError(
            f"layout {name}: `groups` must map names to lists of landmark numbers, lip_gap be two "
            f"of them ({error})"
        ) from error
    return PointLayout(name, groups, (upper, lower))


def _landmarks(numbers: Iterable[object]) -> tuple[int, ...]:
    landmarks = tuple(numbers)
    for number in landmarks:
        if type(number) is not int or number < 0:
            raise ValueError(f"{number!r} is not a landmark number")
    return tuple(n for n in landmarks if isinstance(n, int))


_WITHOUT_INNER_LIPS: tuple[tuple[str, tuple[int, ...]], ...] = (
    (OUTER_LIP_GROUP, (61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181)),
    ("nose", (98, 2, 327)),
    ("jaw", (172, 136, 149, 176, 152, 400, 378, 365, 397)),
    ("chin", (18, 200, 199)),
    ("cheek", (50, 280, 205, 425, 207, 427, 187, 411, 216, 436, 212, 432)),
)
_WITH_INNER_LIPS = (
    *_WITHOUT_INNER_LIPS,
    (INNER_LIP_GROUP, (78, 82, 13, 312, 308, 317, 14, 87)),
)

#: As many as in Wei and Deng; the paper gives the number, not the list: this choice is ours.
MARKERS_39 = PointLayout("markers-39", _WITHOUT_INNER_LIPS, (0, 17))
#: The same and 8 on the inner lips, so that closure is measured and not guessed.
MARKERS_47 = PointLayout("markers-47", _WITH_INNER_LIPS, (13, 14))


def _face_mesh() -> PointLayout:
    """Return the layout of all 478 points: both lips, the irises, and the rest as `skin`."""
    grouped = {*OUTER_LIP, *INNER_LIP, *IRISES}
    groups = (
        (OUTER_LIP_GROUP, OUTER_LIP),
        (INNER_LIP_GROUP, INNER_LIP),
        ("iris", IRISES),
        ("skin", tuple(n for n in range(N_LANDMARKS) if n not in grouped)),
    )
    return PointLayout("face-mesh-478", groups, (13, 14))


FACE_MESH_478 = _face_mesh()

#: By number of points, as `--markers` takes them.
LAYOUTS = {str(each.n_points): each for each in (MARKERS_39, MARKERS_47, FACE_MESH_478)}


def find_layout(choice: str) -> PointLayout:
    """Return a shipped layout by its number of points, or that of a JSON file at the path `choice`.

    Raises LayoutError for a choice that is neither, or a file that describes no layout.
    """
    if choice in LAYOUTS:
        return LAYOUTS[choice]
    path = Path(choice)
    try:
        description = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        known = ", ".join(LAYOUTS)
        raise LayoutError(
            f"{choice}: neither a known layout ({known}) nor a readable file: {error.strerror}"
        ) from error
    except ValueError as error:
        raise LayoutError(f"{path}: not JSON ({error})") from error
    if not isinstance(description, dict):
        raise LayoutError(f"{path}: a layout must be a JSON object with {', '.join(_NEEDED)}")
    try:
        return layout_of(description)
    except LayoutError as error:
        raise LayoutError(f"{path}: {error}") from error
