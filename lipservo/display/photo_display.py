"""Draws a photograph as a frame of the model has it: layer on layer, as pixels of one picture.

From the back: what stays, which gives way round the face; the eyes; the skin with the lips, moved
by the model's targets; the mouth's inside with tongue and teeth, seen through the lips. The skin is
warped by its triangles, never painted: each pixel is looked up in the photograph.
"""

from dataclasses import fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lipservo.display.lip_contact import LipContact, Mesh, Unfolding
from lipservo.display.mouth_inside import MouthInside
from lipservo.display.photo_face import PhotoFace
from lipservo.display.raster import covered
from lipsync.arrays import Array, Indices
from lipsync.errors import check_extra
from lipsync.face.frame import Frame
from lipsync.face.model import FaceModel
from lipsync.markers import INNER_LIP
from lipsync.twin.head_surface import FACE_RIM, LEFT_EYE, RIGHT_EYE, boundary_loops
from lipsync.video.face_detection import Picture

#: How far round the face the background gives way, in parts of its size, and by how much.
_RINGS = ((0.06, 0.9), (0.16, 0.68), (0.30, 0.42), (0.48, 0.2), (0.70, 0.0))
#: A head turned farther than this shows what no photograph from the front has, degrees.
_MOST_POSE_DEG = {"pitch": 10.0, "yaw": 12.0, "roll": 12.0}
#: The background's map is drawn for one pixel in so many each way.
_COARSE = 4
#: What moves less than this is not drawn anew, px.
_STILL_PX = 0.02
#: What lids, brows and smile can be asked for without looking like a mask.
_MOST = {"lid_left": (0.0, 1.0), "lid_right": (0.0, 1.0), "brow": (-0.4, 1.0), "smile": (-0.5, 0.9)}


class PhotoDisplay:
    """Draws one photograph, a frame at a time. Needs OpenCV, the extra `film`."""

    def __init__(self, photo: PhotoFace) -> None:
        check_extra("cv2", "drawing a photograph")
        self._photo = photo
        skin = photo.twin.parts[0]
        triangles = _half_as_fine(skin.triangles)
        front = triangles[_is_face(triangles, photo.twin.face_vertices)]
        self._used = np.unique(front)
        renumbered = np.full(len(skin.places_mm), -1)
        renumbered[self._used] = np.arange(len(self._used))
        self._number = renumbered
        faces = renumbered[front]
        self._places = skin.places_mm[self._used]
        self._targets = {name: moves[self._used] for name, moves in skin.morphs.items()}
        loops = [np.array(loop) for loop in boundary_loops(faces)]
        self._lips = _loop(loops, renumbered[list(INNER_LIP[:2])])
        self._rim = _loop(loops, renumbered[list(FACE_RIM[:2])])
        eyes = [_loop(loops, renumbered[list(each[:2])]) for each in (LEFT_EYE, RIGHT_EYE)]
        self._eyes = np.concatenate(eyes)
        self._own = self._skin_places(Frame(0.0, photo.own))
        own_px = photo.in_picture(self._own)
        depth = own_px[faces, 2].mean(axis=1)
        faces = faces[np.argsort(depth)]
        n = len(own_px)
        eye_fans, first = [], n
        for eye in eyes:
            eye_fans.append(_fan(first, len(eye)))
            first += len(eye) + 1
        eye_px = np.vstack([np.vstack([own_px[eye], own_px[eye].mean(axis=0)]) for eye in eyes])
        rim_px = own_px[self._rim, :2]
        middle = rim_px.mean(axis=0)
        rings = np.vstack([middle + (1 + far) * (rim_px - middle) for far, _ in _RINGS])
        ring_rows = np.vstack([self._rim, first + np.arange(len(rings)).reshape(len(_RINGS), -1)])
        back = np.concatenate([_band(*pair) for pair in pairwise(ring_rows)])
        rest_px = np.vstack([own_px[:, :2], eye_px[:, :2], rings])
        behind = np.vstack([back[::-1], *eye_fans])
        self._eye_fans = slice(len(back), len(behind))
        self._mesh = Mesh(
            rest_px, np.vstack([behind, faces]), slice(len(behind), len(behind) + len(faces))
        )
        self._contact = LipContact(photo, own_px, self._lips)
        self._unfold = Unfolding(rest_px, self._mesh)
        self._inside = MouthInside(photo, own_px[self._lips])
        self._eye_rows = [np.arange(len(each) + 1) for each in eyes]
        height, width = photo.picture.shape[:2]
        low = np.clip(np.floor(rest_px.min(axis=0)) - 1, 0, None).astype(int)
        high = np.clip(np.ceil(rest_px.max(axis=0)) + 2, None, (width, height)).astype(int)
        self._box = (slice(low[1], high[1]), slice(low[0], high[0]))
        rows, columns = np.mgrid[self._box].astype(np.float32)
        self._still = np.stack([columns, rows])
        n_coarse = -(-np.array(self._still.shape[1:]) // _COARSE) + 1
        rows, columns = (_COARSE * np.mgrid[: n_coarse[0], : n_coarse[1]]).astype(np.float32)
        self._still_coarse = np.stack([columns + low[0], rows + low[1]])
        rows, columns = (self._still[::-1] - low[::-1, None, None]).astype(np.float32) / _COARSE
        self._at_coarse = np.ascontiguousarray(columns), np.ascontiguousarray(rows)

    @property
    def mesh(self) -> Mesh:
        """The mesh that is warped, at rest."""
        return self._mesh

    @property
    def own(self) -> Array:
        """Coefficients of the mouth as it was photographed.

        Returns
        -------
        Array
            (n_components,).
        """
        return self._photo.own

    def model_moves_px(self, face: FaceModel, coefficients: Array) -> Array:
        """Return how far the model's points are from where the photograph has them.

        Parameters
        ----------
        face : FaceModel
            The model.
        coefficients : Array
            (n_components,).

        Returns
        -------
        Array
            (n_points, 2) pixels.
        """
        moves = face.markers_mm((coefficients - self._photo.own)[None])[0] - face.mean_mm
        return np.asarray((moves @ self._photo.matrix.T)[:, :2])

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self._photo.picture.shape[:2]
        return width, height

    def draw(self, frame: Frame) -> Picture:
        """The photograph with the face of a frame."""
        import cv2

        moved_px, depth_px = self.moved(frame)
        maps = self.source_of(moved_px)
        picture = self._photo.picture.copy()
        face = cv2.remap(
            self._photo.picture, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        picture[self._box] = face
        lips = np.column_stack([moved_px[self._lips], depth_px[self._lips]])
        self._inside.draw_into(picture, frame, lips, self._turn(frame))
        return picture

    def moved(self, frame: Frame) -> tuple[Array, Array]:
        """Return where the mesh's vertices are.

        Parameters
        ----------
        frame : Frame
            Mouth and expression.

        Returns
        -------
        tuple[Array, Array]
            (n, 2) pixels; and the depth of the skin's vertices, (n_skin,).
        """
        places = self._skin_places(frame)
        turn, shift = self._turn(frame)
        skin = self._contact.held(self._photo.in_picture(places), frame) @ turn.T + shift
        still = self._photo.in_picture(self._own) @ turn.T + shift
        eyes, first = [], 0
        for rows in self._eye_rows:
            rim = still[self._eyes[first : first + len(rows) - 1], :2]
            eyes.append(np.vstack([rim, rim.mean(axis=0)]))
            first += len(rows) - 1
        rest = self._mesh.rest_px
        rim = _smooth(skin[self._rim, :2] - rest[self._rim])
        n_rings = len(_RINGS) * len(self._rim)
        rings = rest[-n_rings:] + np.vstack([share * rim for _, share in _RINGS])
        return self._unfold.unfolded(np.vstack([skin[:, :2], *eyes, rings])), skin[:, 2]

    def source_of(self, moved_px: Array) -> NDArray[np.float32]:
        """Return from where in the photograph each pixel of the moving part comes.

        Parameters
        ----------
        moved_px : Array
            (n, 2), of `moved`.

        Returns
        -------
        NDArray[np.float32]
            (2, rows, columns) pixels.
        """
        rest = self._mesh.rest_px
        still = np.asarray((np.abs(moved_px - rest) < _STILL_PX).all(axis=1))
        # Where nothing moves the map is there already; but what lies over what moves is drawn.
        goes = np.asarray(~still[self._mesh.triangles].all(axis=1))
        goes[self._mesh.skin] |= not still[self._eyes].all()
        around = np.flatnonzero(goes[: self._mesh.skin.start])
        maps = self._still
        if len(around):  # smooth and wide: a coarse map will do, of all there is
            maps = self._coarse(moved_px)
        maps = maps.copy()
        skin = self._mesh.triangles[self._mesh.skin][goes[self._mesh.skin]]
        fine = np.vstack([self._mesh.triangles[self._eye_fans], skin])
        self._draw(maps, moved_px - self.corner_px, rest, fine)
        return maps

    def _coarse(self, moved_px: Array) -> NDArray[np.float32]:
        """The map of everything, from one pixel in so many each way."""
        import cv2

        corner = np.array(self.corner_px)
        maps = self._still_coarse.copy()
        self._draw(maps, (moved_px - corner) / _COARSE, self._mesh.rest_px, self._mesh.triangles)
        columns, rows = self._at_coarse
        offsets = (maps - self._still_coarse).astype(np.float32)
        wide = [
            cv2.remap(each, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for each in offsets
        ]
        return np.asarray(self._still + np.stack(wide))

    @staticmethod
    def _draw(
        maps: NDArray[np.float32], moved_px: Array, rest_px: Array, triangles: Indices
    ) -> None:
        corners = moved_px[triangles]
        found = covered(corners, *maps.shape[1:])
        flat = found.rows * maps.shape[2] + found.columns
        for layer, values in zip(
            maps, found.interpolated(corners, rest_px[triangles]), strict=True
        ):
            layer.reshape(-1)[flat] = values

    @property
    def corner_px(self) -> tuple[int, int]:
        """Column and row at which `source_of` begins."""
        return self._box[1].start, self._box[0].start

    def vertex_of(self, landmark: int) -> int:
        """The mesh's vertex of a landmark of the 478-point face mesh; -1: it is not drawn."""
        return int(self._number[landmark])

    def _skin_places(self, frame: Frame) -> Array:
        places = self._places.copy()
        for name, amount in amounts_of(frame, self._photo.twin.components).items():
            if amount:
                places += amount * self._targets[name]
        return places

    def _turn(self, frame: Frame) -> tuple[Array, Array]:
        """Of the head, in the picture: `px @ turn.T + shift`, about the twin's pivot."""
        angles = pose_rad(frame)
        if not any(angles):
            return np.eye(3), np.zeros(3)
        own = self._photo.matrix / self._photo.px_per_mm
        turn = own @ rotation(*angles) @ own.T
        pivot = self._photo.in_picture(self._photo.twin.pivot_mm)
        return turn, pivot - turn @ pivot


def amounts_of(frame: Frame, components: tuple[str, ...]) -> dict[str, float]:
    """How much of each target a frame asks for; what it leaves open is at rest."""
    amounts = dict(zip(components, np.asarray(frame.coefficients).tolist(), strict=True))
    values = {each.name: getattr(frame.expression, each.name) for each in fields(frame.expression)}
    for name, (least, most) in _MOST.items():
        amounts[name] = min(most, max(least, values[name] or 0.0))
    for side in ("left", "right"):
        lid = amounts[f"lid_{side}"]
        amounts[f"lid_{side}_over"] = lid * (1 - lid)
    return amounts


def pose_rad(frame: Frame) -> tuple[float, float, float]:
    """Pitch, yaw and roll of the head that a photograph bears."""
    expression = frame.expression
    angles_deg = (expression.neck_pitch_deg, expression.neck_yaw_deg, expression.neck_roll_deg)
    most = _MOST_POSE_DEG.values()
    within = [max(-m, min(m, deg or 0.0)) for deg, m in zip(angles_deg, most, strict=True)]
    pitch, yaw, roll = np.radians(within).tolist()
    return pitch, yaw, roll


def rotation(pitch: float, yaw: float, roll: float) -> Array:
    """Return the rotation by roll, then pitch, then yaw; x to the right, y up, z to the viewer.

    Parameters
    ----------
    pitch,yaw,roll : float
        Radians: up, to the face's own left, to its left shoulder.

    Returns
    -------
    Array
        (3, 3).
    """
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(a), np.sin(a)) for a in (-pitch, yaw, -roll))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_y @ about_x @ about_z)


def _half_as_fine(triangles: Indices) -> Indices:
    """One triangle for each four of the last subdivision, which keeps its corners' numbers."""
    four = triangles.reshape(-1, 4, 3)
    return np.column_stack([four[:, 0, 0], four[:, 1, 1], four[:, 2, 2]])


def _is_face(triangles: Indices, is_face: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(is_face[triangles].all(axis=1))


def _loop(loops: list[Indices], start: Indices) -> Indices:
    """The hole that goes through a vertex, from it towards another one."""
    first, then = start.tolist()
    (loop,) = (each for each in loops if first in each)
    at = int(np.flatnonzero(loop == first)[0])
    turned = np.roll(loop, -at)
    if int(np.flatnonzero(turned == then)[0]) < len(turned) / 2:
        return turned
    return np.concatenate([turned[:1], turned[:0:-1]])


def _fan(first: int, n: int) -> Indices:
    """Triangles of a loop of vertices and its middle, which comes after them."""
    here = first + np.arange(n)
    return np.column_stack([here, np.roll(here, -1), np.full(n, first + n)])


def _band(inner: Indices, outer: Indices) -> Indices:
    ahead, outer_ahead = np.roll(inner, -1), np.roll(outer, -1)
    return np.vstack(
        [np.column_stack([inner, ahead, outer]), np.column_stack([ahead, outer_ahead, outer])]
    )


def _smooth(moves: Array) -> Array:
    """Of neighbours on the rim, so that the rings round it do not cross."""
    around = [np.roll(moves, shift, axis=0) for shift in range(-4, 5)]
    return np.asarray(np.mean(around, axis=0))
