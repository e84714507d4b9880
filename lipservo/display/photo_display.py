"""Drawing of a photograph with the mouth and expression of a frame, layer on layer.

From the back: the still parts, the eyes and the skin, warped by `photo_warp.py`; the mouth's inside
with tongue and teeth, seen through the lips. The skin is never painted: each of its pixels comes
from the photograph.
"""

import numpy as np
from numpy.typing import NDArray

from lipservo.display.mouth_inside import MouthInside
from lipservo.display.photo_face import PhotoFace
from lipservo.display.photo_warp import PhotoWarp
from lipservo.display.raster import covered
from lipsync.arrays import Array, Indices
from lipsync.errors import check_extra
from lipsync.face.frame import Frame
from lipsync.face.model import FaceModel
from lipsync.video.face_detection import Picture

#: The background's map is computed for one pixel in so many each way.
_COARSE = 4
#: Triangles whose vertices move less than this are not drawn anew, px.
_STILL_PX = 0.02


class PhotoDisplay:
    """A display of one photograph, drawn a frame at a time. Needs OpenCV, the extra `film`.

    A map holds for each pixel of the moving part its position in the photograph; `_still` is
    that of a face that does not move.
    """

    def __init__(self, photo: PhotoFace) -> None:
        """Prepare the maps of `photo`, in full and at every fourth pixel each way.

        Raises MissingExtraError without OpenCV.
        """
        check_extra("cv2", "drawing a photograph")
        self._photo = photo
        self.warp = PhotoWarp(photo)
        self._mesh = self.warp.mesh
        self._eyes = np.concatenate(self.warp.eyes)
        self._inside = MouthInside(photo, self.warp.own_px[self.warp.lips])
        rest_px = self._mesh.rest_px
        height, width = photo.picture.shape[:2]
        # The part of the picture in which something moves.
        low = np.clip(np.floor(rest_px.min(axis=0)) - 1, 0, None).astype(int)
        high = np.clip(np.ceil(rest_px.max(axis=0)) + 2, None, (width, height)).astype(int)
        self._box = (slice(low[1], high[1]), slice(low[0], high[0]))
        rows, columns = np.mgrid[self._box].astype(np.float32)
        self._still = np.stack([columns, rows])
        n_coarse = -(-np.array(self._still.shape[1:]) // _COARSE) + 1
        rows, columns = (_COARSE * np.mgrid[: n_coarse[0], : n_coarse[1]]).astype(np.float32)
        self._coarse_still = np.stack([columns + low[0], rows + low[1]])
        rows, columns = (self._still[::-1] - low[::-1, None, None]).astype(np.float32) / _COARSE
        self._coarse_positions = np.ascontiguousarray(columns), np.ascontiguousarray(rows)

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
        """Return how far a mouth shape moves the model's points from where they are photographed.

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
        """Return the photograph with a frame's mouth and expression, (height, width, 3) RGB."""
        import cv2

        moved_px, depth_px = self.warp.moved(frame)
        maps = self.source_of(moved_px)
        picture = self._photo.picture.copy()
        face = cv2.remap(
            self._photo.picture, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        picture[self._box] = face
        lips = np.column_stack([moved_px[self.warp.lips], depth_px[self.warp.lips]])
        self._inside.draw_into(picture, frame, lips, self.warp.turn(frame))
        return picture

    def source_of(self, moved_px: Array) -> NDArray[np.float32]:
        """Return the position in the photograph from which each pixel of the moving part comes.

        Parameters
        ----------
        moved_px : Array
            (n, 2) pixels, the mesh's vertices from `PhotoWarp.moved`.

        Returns
        -------
        NDArray[np.float32]
            (2, rows, columns) pixels, x and y; row 0 and column 0 are `corner_px` in the picture.
        """
        rest = self._mesh.rest_px
        is_still = np.asarray((np.abs(moved_px - rest) < _STILL_PX).all(axis=1))
        # Triangles that do not move are in the map already; but when an eye moves, the skin, which
        # lies over the eyes, is drawn as well.
        moves = np.asarray(~is_still[self._mesh.triangles].all(axis=1))
        moves[self._mesh.skin] |= not is_still[self._eyes].all()
        moved_background = np.flatnonzero(moves[: self._mesh.skin.start])
        # The background is smooth and wide: a coarse map will do, of all there is.
        maps = self._coarse_map(moved_px) if len(moved_background) else self._still.copy()
        skin = self._mesh.triangles[self._mesh.skin][moves[self._mesh.skin]]
        fine = np.vstack([self._mesh.triangles[self.warp.eye_fans], skin])
        self._fill(maps, moved_px - self.corner_px, rest, fine)
        return maps

    def _coarse_map(self, moved_px: Array) -> NDArray[np.float32]:
        """Return the map of `source_of` for all of the mesh, from every fourth pixel each way."""
        import cv2

        corner = np.array(self.corner_px)
        maps = self._coarse_still.copy()
        self._fill(maps, (moved_px - corner) / _COARSE, self._mesh.rest_px, self._mesh.triangles)
        columns, rows = self._coarse_positions
        offsets = (maps - self._coarse_still).astype(np.float32)
        wide = [
            cv2.remap(each, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for each in offsets
        ]
        return np.asarray(self._still + np.stack(wide))

    @staticmethod
    def _fill(
        maps: NDArray[np.float32], moved_px: Array, rest_px: Array, triangles: Indices
    ) -> None:
        """Write into `maps` from where in the photograph the pixels of moved triangles come.

        maps: (2, rows, columns), x and y in pixels, changed in place. moved_px, rest_px: (n, 2)
        vertices in pixels of the maps and of the photograph. triangles: (m, 3) indices of vertices.
        """
        corners = moved_px[triangles]
        covered_pixels = covered(corners, *maps.shape[1:])
        flat_indices = covered_pixels.rows * maps.shape[2] + covered_pixels.columns
        for layer, values in zip(
            maps, covered_pixels.interpolated(corners, rest_px[triangles]), strict=True
        ):
            layer.reshape(-1)[flat_indices] = values

    @property
    def corner_px(self) -> tuple[int, int]:
        """Column and row of the picture at which the map of `source_of` begins."""
        return self._box[1].start, self._box[0].start
