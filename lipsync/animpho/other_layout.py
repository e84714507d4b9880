"""A face seen at other points than it was trained with: what calibration needs of any model.

Robots are calibrated at 47 named markers. A model of more points has them among its own; where one
has no inner lips, they are taken to move with the outer ones: a lip keeps its thickness, and both
meet half-way between the outer lips when the mouth is at rest.
"""

from dataclasses import dataclass

import numpy as np

from lipsync.animpho.units import FaceWithAnimPhos, face_fields
from lipsync.markers import LayoutError, PointLayout

#: For each point of the inner lips the outer one that it moves with, and the one opposite to it.
_OUTER_OF_INNER = {
    78: (61, 61), 308: (291, 291),
    82: (37, 84), 13: (0, 17), 312: (267, 314),
    87: (84, 37), 14: (17, 0), 317: (314, 267),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class FaceInOtherLayout(FaceWithAnimPhos):
    """The same face at other points: the same coefficients, AnimPhos and checksum.

    The rows of its basis are no longer orthonormal: it makes markers, and reads none.
    """

    own_checksum: str

    @property
    def checksum(self) -> str:
        """That of the model it was made from."""
        return self.own_checksum


def in_layout(model: FaceWithAnimPhos, layout: PointLayout) -> FaceWithAnimPhos:
    """The face at the points of a layout. Raises LayoutError for a point that cannot be told."""
    if model.layout == layout:
        return model
    basis = model.basis.reshape(model.n_components, -1, 3)
    rest_mm = model.markers_mm(model.rest[None])[0]
    at = {landmark: i for i, landmark in enumerate(model.layout.landmarks)}
    means, rows = [], []
    for landmark in layout.landmarks:
        mean_mm = model.mean_mm[at[landmark]] if landmark in at else None
        moves_with = landmark
        if mean_mm is None:
            moves_with, opposite = _OUTER_OF_INNER.get(landmark, (landmark, landmark))
            if not {moves_with, opposite} <= set(at):
                raise LayoutError(
                    f"a model of {model.layout.name} does not tell where landmark {landmark} is; "
                    f"train one with --markers {layout.n_points}"
                )
            thickness_mm = (rest_mm[at[opposite]] - rest_mm[at[moves_with]]) / 2.0
            mean_mm = model.mean_mm[at[moves_with]] + thickness_mm
        means.append(mean_mm)
        rows.append(basis[:, at[moves_with]])
    fields = face_fields(model) | {
        "layout": layout,
        "mean_mm": np.array(means),
        "basis": np.stack(rows, axis=1).reshape(model.n_components, -1),
    }
    return FaceInOtherLayout(**fields, animphos=model.animphos, own_checksum=model.checksum)
