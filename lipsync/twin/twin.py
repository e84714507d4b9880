"""The twin of a face model: its mouth on the mean face, as morph targets.

The shell is linear and so is the face model, so the whole is too: with markers m = mu + c P the
skin is V + W (m - V_markers) = (V + T_0) + sum_k c_k T_k. One target a component, one number a
component a frame, and nothing is solved after the start.
"""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array, Indices
from lipsync.errors import UserError
from lipsync.face.head_motion import apply_similarity, fit_similarity
from lipsync.face.model import FaceModel
from lipsync.face_mesh import INNER_LIP
from lipsync.twin.expression_morphs import expression_morphs
from lipsync.twin.eyes import eyeballs, lid_lining
from lipsync.twin.head_surface import HeadSurface, head_surface
from lipsync.twin.jaw import jaw_motion
from lipsync.twin.landmarks import CHIN, JAW_JOINT, N_SKIN
from lipsync.twin.mean_face import MeanFace, load_mean_face
from lipsync.twin.mouth_parts import MouthFrame, mouth_parts
from lipsync.twin.neck import PIVOT_MM, neck
from lipsync.twin.part import Eyeball, Part
from lipsync.twin.shell import influence


class TwinError(UserError):
    """A face model that this head cannot wear: says why."""


@dataclass(frozen=True, slots=True)
class Twin:
    """A head to draw.

    parts: the first is the skin. components: names of the targets of the mouth, in the order of the
    model's coefficients; rest: (n_components,), the closed mouth; deviations: (n_components,), how
    much each component varies in speech. The other targets are lid_left, lid_right, brow and smile
    as in `Expression`, and lid_left_over, lid_right_over for lid (1 - lid). pivot_mm: what the head
    turns about.
    """

    parts: tuple[Part, ...]
    eyes: tuple[Eyeball, ...]
    components: tuple[str, ...]
    rest: Array
    deviations: Array
    pivot_mm: Array

    @property
    def n_triangles(self) -> int:
        """Of the skin alone."""
        return len(self.parts[0].triangles)


@dataclass(frozen=True, slots=True)
class SkinMorphs:
    """The skin as a linear function of the coefficients.

    places_mm (n, 3): V + T_0. targets_mm (n_components, n, 3). weights (n, n_points): of the shell,
    the points being those of the model that lie on skin; `points`: their rows in the model.
    """

    places_mm: Array
    targets_mm: Array
    weights: Array
    points: tuple[int, ...]


def make_twin(face: FaceModel, mean: MeanFace | None = None) -> Twin:
    """The twin of a model; on the shipped head unless another is given. Raises TwinError."""
    mean = mean or load_mean_face()
    surface = head_surface(mean)
    skin = skin_morphs(face, surface)
    eyes = eyeballs(surface, mean.irises_mm)
    components = tuple(f"c{k}" for k in range(face.n_components))
    of_mouth = dict(zip(components, skin.targets_mm, strict=True))
    morphs = of_mouth | expression_morphs(surface, eyes)
    lips = np.array(surface.loop_from(*INNER_LIP[:2]))
    parts = (
        Part("skin", skin.places_mm, surface.triangles, surface.colours, morphs),
        *(lid_lining(surface, morphs, eye) for eye in eyes),
        *mouth_parts(_mouth_frame(skin.places_mm, lips, morphs, components)),
        neck(),
    )
    deviations = np.sqrt(np.diag(face.covariance))
    return Twin(parts, eyes, components, face.rest, deviations, np.array(PIVOT_MM))


def skin_morphs(face: FaceModel, surface: HeadSurface) -> SkinMorphs:
    """V + T_0 and T_k of a model on a surface. Raises TwinError."""
    landmarks = face.layout.landmarks
    points = tuple(i for i, landmark in enumerate(landmarks) if landmark < N_SKIN)
    handles = [landmarks[i] for i in points]
    if len(points) < 3:
        raise TwinError(
            f"layout {face.layout.name}: its points are not numbered as the 478-point face mesh "
            "numbers them, so they have no place on the twin's head"
        )
    weights = influence(surface.stiffness, handles, surface.anchors.tolist())
    at_mean, turned = worn_face(face, surface.places_mm[handles], points)
    offsets = weights @ (at_mean - surface.places_mm[handles])
    return SkinMorphs(
        surface.places_mm + offsets, np.stack([weights @ each for each in turned]), weights, points
    )


def worn_face(face: FaceModel, on_head_mm: Array, points: tuple[int, ...]) -> tuple[Array, Array]:
    """Mean (n_points, 3) and basis (n_components, n_points, 3) of the model, laid on the head.

    The model's head is turned as its speaker sat, and another speaker's has another size; the
    similarity that lays the closed mouth on the head's own removes both.
    """
    chosen = list(points)
    at_rest = face.markers_mm(face.rest[None])[:, chosen]
    scale, rotation, translation = fit_similarity(at_rest, on_head_mm)
    at_mean = apply_similarity(face.mean_mm[None, chosen], scale, rotation, translation)[0]
    basis = face.basis.reshape(face.n_components, -1, 3)[:, chosen]
    return at_mean, scale[0] * basis @ rotation[0].T


def _mouth_frame(
    places: Array, lips: Indices, morphs: dict[str, Array], components: tuple[str, ...]
) -> MouthFrame:
    chin = list(CHIN)
    joint = places[list(JAW_JOINT)].mean(axis=0)
    moves = np.stack([morphs[name][chin] for name in components])
    motion = jaw_motion(places[chin], joint, moves)
    return MouthFrame(
        places[lips],
        {name: morphs[name][lips] for name in (*components, "smile")},
        places[[INNER_LIP[5], INNER_LIP[15]]].mean(axis=0),
        joint,
        dict(zip(components, motion, strict=True)),
    )
