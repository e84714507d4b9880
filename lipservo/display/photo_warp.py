"""The warp of a photograph: a flat mesh, whose vertices are moved by a frame.

From the back: rings round the face, which follow its rim; the eyes; the skin with the lips, moved
by the model's targets. Lips touch where the model's do, and no triangle turns over
(`lip_contact.py`). `lipservo/dashboard/static/show/photo_warp.js` computes the same in a page.
"""

from itertools import pairwise

import numpy as np

from lipservo.display.lip_contact import LipContact, Mesh, Unfolding
from lipservo.display.photo_face import PhotoFace
from lipsync.arrays import Array, Indices
from lipsync.face.frame import Frame
from lipsync.markers import INNER_LIP
from lipsync.twin.head_surface import FACE_RIM, LEFT_EYE, RIGHT_EYE, boundary_loops

#: Rings of vertices round the face: how far outside its rim, in parts of its size, and which share
#: of the rim's motion each follows; beyond the last the background is still.
RINGS = ((0.06, 0.9), (0.16, 0.68), (0.30, 0.42), (0.48, 0.2), (0.70, 0.0))
#: The rings follow the rim's motion averaged over so many neighbours on each side.
RIM_NEIGHBOURS = 4
#: A head turned farther than this shows what no photograph from the front has, degrees.
MOST_POSE_DEG = {"pitch": 10.0, "yaw": 12.0, "roll": 12.0}
#: Limits of the expression in a photograph: beyond them a face looks like a mask.
MOST = {
    "lid_left": (0.0, 1.0),
    "lid_right": (0.0, 1.0),
    "brow": (-0.4, 1.0),
    "smile": (-0.5, 0.9),
    "lip_tuck": (0.0, 1.0),
    "tongue_dental": (0.0, 1.0),
    "tongue_alveolar": (0.0, 1.0),
}


class PhotoWarp:
    """The mesh of one photograph, moved by frames.

    The mesh's vertices are those of the skin, then of each eye its rim and its middle, then rings
    round the face. places_mm (n_skin, 3): the skin's vertices on the head. targets: by the name of
    a motion of the head (a component of the model, or lids, brows, smile), how far the amount 1 of
    it moves each vertex of the skin, mm. own_px (n_skin, 3): the skin's vertices as photographed,
    with depth. lips, rim, eyes: rows of the skin's vertices round the inner lips (from a corner),
    the face and each eye. mesh: the flat mesh. eye_fans: rows of its triangles that are eyes.
    contact: brings lips together.
    """

    def __init__(self, photo: PhotoFace) -> None:
        """Build the mesh of `photo`: the face's skin, the eyes, and rings round the face."""
        self._photo = photo
        skin = photo.twin.parts[0]
        triangles = _coarser_triangles(skin.triangles)
        front = triangles[photo.twin.face_vertices[triangles].all(axis=1)]
        # Only the vertices of the face are used, numbered anew.
        used_vertices = np.unique(front)
        self._number = np.full(len(skin.places_mm), -1)
        self._number[used_vertices] = np.arange(len(used_vertices))
        faces = self._number[front]
        self.places_mm = skin.places_mm[used_vertices]
        self.targets = {name: moves[used_vertices] for name, moves in skin.morphs.items()}
        loops = [np.array(loop) for loop in boundary_loops(faces)]
        self.lips = _loop(loops, self._number[list(INNER_LIP[:2])])
        self.rim = _loop(loops, self._number[list(FACE_RIM[:2])])
        self.eyes = [_loop(loops, self._number[list(each[:2])]) for each in (LEFT_EYE, RIGHT_EYE)]
        #: Of the skin in the photograph, with depth.
        self.own_px = own_px = photo.in_picture(self._skin_places_mm(Frame(0.0, photo.own)))
        # From the back to the front. The eyes' vertices come after the skin's.
        faces = faces[np.argsort(own_px[faces, 2].mean(axis=1))]
        first = len(own_px)
        eye_fans = []
        for eye in self.eyes:
            eye_fans.append(_fan_triangles(first, len(eye)))
            first += len(eye) + 1
        # Rings of vertices, each a larger copy of the rim about its middle.
        rim_px = own_px[self.rim, :2]
        middle = rim_px.mean(axis=0)
        rings = np.vstack([middle + (1 + far) * (rim_px - middle) for far, _ in RINGS])
        ring_rows = np.vstack([self.rim, first + np.arange(len(rings)).reshape(len(RINGS), -1)])
        # The background's triangles, and those of the eyes, are drawn before the skin.
        back = np.concatenate([_band_triangles(*pair) for pair in pairwise(ring_rows)])
        rest_px = np.vstack([own_px[:, :2], *self._eyes_px(own_px), rings])
        behind = np.vstack([back[::-1], *eye_fans])
        #: Rows of the mesh's triangles that are eyes.
        self.eye_fans = slice(len(back), len(behind))
        self.mesh = Mesh(
            rest_px, np.vstack([behind, faces]), slice(len(behind), len(behind) + len(faces))
        )
        self.contact = LipContact(photo, own_px, self.lips)
        self._unfold = Unfolding(rest_px, self.mesh)

    def moved(self, frame: Frame) -> tuple[Array, Array]:
        """Return the positions of the mesh's vertices in a frame.

        Parameters
        ----------
        frame : Frame
            Mouth shape and expression.

        Returns
        -------
        tuple[Array, Array]
            (n, 2) pixels; and the depth of the skin's vertices, (n_skin,).
        """
        turn, shift = self.turn(frame)
        places_px = self._photo.in_picture(self._skin_places_mm(frame))
        # The skin and the eyes turn with the head; rings follow the rim of the face.
        skin = self.contact.bring_together(places_px, frame) @ turn.T + shift
        eyes = self._eyes_px(self.own_px @ turn.T + shift)
        rest = self.mesh.rest_px
        rim = _smoothed_along_rim(skin[self.rim, :2] - rest[self.rim])
        rings = rest[-len(RINGS) * len(rim) :] + np.vstack([share * rim for _, share in RINGS])
        return self._unfold.unfolded(np.vstack([skin[:, :2], *eyes, rings])), skin[:, 2]

    def turn(self, frame: Frame) -> tuple[Array, Array]:
        """Return a frame's head rotation (3, 3) and shift (3,), in px: `px @ turn.T + shift`.

        The head turns about the neck.
        """
        angles = pose_rad(frame)
        if not any(angles):
            return np.eye(3), np.zeros(3)
        picture_axes = self._photo.matrix / self._photo.px_per_mm
        turn = picture_axes @ rotation(*angles) @ picture_axes.T
        pivot = self._photo.in_picture(self._photo.twin.pivot_mm)
        return turn, pivot - turn @ pivot

    def vertex_of(self, landmark: int) -> int:
        """Return the mesh's vertex of a landmark of the 478-point face mesh; -1: not drawn."""
        return int(self._number[landmark])

    def _eyes_px(self, skin_px: Array) -> list[Array]:
        """Return of each eye the vertices of its rim and its middle, (n_rim + 1, 2)."""
        loops = [skin_px[eye, :2] for eye in self.eyes]
        return [np.vstack([loop, loop.mean(axis=0)]) for loop in loops]

    def _skin_places_mm(self, frame: Frame) -> Array:
        """Return the places of the skin's vertices on the head in a frame, (n_skin, 3) mm."""
        places = self.places_mm.copy()
        amounts = amounts_of(frame, self._photo.twin.components)
        for name, moves in self.targets.items():
            if amounts[name]:
                places += amounts[name] * moves
        return places


def amounts_of(frame: Frame, components: tuple[str, ...]) -> dict[str, float]:
    """Return the amount of each target, a named motion of the head, in a frame.

    components: names of its coefficients, which are their amounts. Amounts of the expression are
    clipped to `MOST`, and 0 if they are not set.
    """
    amounts = dict(zip(components, np.asarray(frame.coefficients).tolist(), strict=True))
    for name, (least, most) in MOST.items():
        amounts[name] = min(most, max(least, getattr(frame.expression, name) or 0.0))
    for side in ("left", "right"):
        # The target that keeps a half shut lid outside the eyeball (lipsync/twin/twin.py).
        lid = amounts[f"lid_{side}"]
        amounts[f"lid_{side}_over"] = lid * (1 - lid)
    return amounts


def pose_rad(frame: Frame) -> tuple[float, float, float]:
    """Return pitch, yaw and roll of a frame's head in rad, limited to `MOST_POSE_DEG`."""
    expression = frame.expression
    angles_deg = (expression.neck_pitch_deg, expression.neck_yaw_deg, expression.neck_roll_deg)
    most = MOST_POSE_DEG.values()
    within = [max(-m, min(m, deg or 0.0)) for deg, m in zip(angles_deg, most, strict=True)]
    pitch, yaw, roll = np.radians(within).tolist()
    return pitch, yaw, roll


def rotation(pitch: float, yaw: float, roll: float) -> Array:
    """Return the matrix of a rotation by roll, then pitch, then yaw of a head.

    Axes: x to the right, y up, z to the viewer.

    Parameters
    ----------
    pitch,yaw,roll : float
        Radians: up, to the face's own left, to its left shoulder.

    Returns
    -------
    Array
        (3, 3), to be multiplied with column vectors.
    """
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(a), np.sin(a)) for a in (-pitch, yaw, -roll))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_y @ about_x @ about_z)


def _coarser_triangles(triangles: Indices) -> Indices:
    """Return the triangles before the last subdivision into four, (n, 3) -> (n / 4, 3).

    Four triangles in a row are the parts of one, and its corners are those of the first three.
    """
    four = triangles.reshape(-1, 4, 3)
    return np.column_stack([four[:, 0, 0], four[:, 1, 1], four[:, 2, 2]])


def _loop(loops: list[Indices], start: Indices) -> Indices:
    """Return the loop of vertices through start[0], from it on in the direction of start[1]."""
    first, then = start.tolist()
    (loop,) = (each for each in loops if first in each)
    turned = np.roll(loop, -int(np.flatnonzero(loop == first)[0]))
    if int(np.flatnonzero(turned == then)[0]) < len(turned) / 2:
        return turned
    return np.concatenate([turned[:1], turned[:0:-1]])


def _fan_triangles(first: int, n: int) -> Indices:
    """Return triangles from a loop of `n` vertices from `first` on to its middle, the next one."""
    loop = first + np.arange(n)
    return np.column_stack([loop, np.roll(loop, -1), np.full(n, first + n)])


def _band_triangles(inner: Indices, outer: Indices) -> Indices:
    """Return triangles that fill the band between two loops of equally many vertices, (2 n, 3)."""
    ahead, outer_ahead = np.roll(inner, -1), np.roll(outer, -1)
    return np.vstack(
        [np.column_stack([inner, ahead, outer]), np.column_stack([ahead, outer_ahead, outer])]
    )


def _smoothed_along_rim(moves: Array) -> Array:
    """Return the rim's moves (n, 2), averaged over neighbours, so that rings do not cross."""
    shifts = range(-RIM_NEIGHBOURS, RIM_NEIGHBOURS + 1)
    return np.asarray(np.mean([np.roll(moves, shift, axis=0) for shift in shifts], axis=0))
