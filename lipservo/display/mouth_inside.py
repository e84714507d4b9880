"""The mouth's inside as seen between the lips of a photograph: teeth, tongue and darkness.

Teeth and tongue are those of the twin (the program's drawn head, `lipsync/twin/parts.py`), drawn
once as small pictures (sprites): upper teeth stay with the head, lower teeth and a raised tongue
move with the jaw. All darken as the lips close, since less light enters.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo.display.photo_face import PhotoFace
from lipservo.display.photo_warp import amounts_of
from lipservo.display.raster import covered
from lipsync.arrays import Array, Indices
from lipsync.face.frame import Frame
from lipsync.twin.packed import vertex_normals
from lipsync.twin.parts import Part
from lipsync.video.face_detection import Picture

Pixels = NDArray[np.float32]
#: Sprites are drawn so many times as large, and brought to size where they are shown.
_FINE = 3
#: Where the light comes from: x right, y up, z to the viewer.
_LIGHT = np.array([-0.25, 0.35, 0.9]) / np.linalg.norm([-0.25, 0.35, 0.9])
#: Light between the lips: least, and from which gap to which, mm, as in the page's twin.
LEAST_LIGHT, DARK_MM, LIGHT_MM = 0.15, 0.9, 6.0
#: Lips that are no farther apart in a photograph are closed there.
_CLOSED_MM = 2.0
#: Lips nearer than this touch, mm; the shade between lips that hardly part, and up to what gap, mm.
SLIT_MM, SHADE, PARTED_MM = 0.35, 0.55, 1.6
#: Behind the teeth, sRGB.
DARKNESS = np.array([38.0, 14.0, 14.0], dtype=np.float32)
#: An inner lip is seen this far into the mouth, mm, before it is in its own shadow.
SHADOW_MM = 2.2


@dataclass(frozen=True, slots=True)
class _Sprite:
    """A small picture, (rows, columns, 4): red, green, blue and the covered share of each pixel.

    corner_px (3,): its upper left corner in the photograph, with depth.
    """

    pixels: Pixels
    corner_px: Array


@dataclass(frozen=True, slots=True)
class SeenPart:
    """A part of the twin (the program's own head) in the pose of a photograph, shaded.

    places_px (n, 3), with depth. colours (n, 3): sRGB, 0 to 255. triangles: from back to front.
    moves_px: by target (a named motion of the head), how far the amount 1 of it moves the part.
    raised_by: the target that raises the part, which is a tongue and fully raised; "": teeth.
    """

    places_px: Array
    colours: Array
    triangles: Indices
    moves_px: dict[str, Array]
    raised_by: str


class MouthParts:
    """The parts of the twin's head behind the lips of one photograph, and how they are seen.

    lips_px (n, 3): the inner rim of the lips as photographed. layers: teeth and tongue, from the
    back. upper_rows, lower_rows: rows of the rim, from corner to corner, that face each other.
    hidden_px (n_pairs,): gap of each pair up to which nothing is seen inside.
    """

    def __init__(self, photo: PhotoFace, lips_px: Array) -> None:
        """Take teeth and tongue from the photograph's head; pair the rows of the rim."""
        parts = {part.name: part for part in photo.twin.parts}
        lower, tongue = parts["teeth_lower"], parts["tongue"]
        # The front teeth show how far the jaw moves what is seen.
        front = lower.places_mm[:, 2] > lower.places_mm[:, 2].max() - 6.0
        jaw_px = {
            name: photo.matrix @ moves[front].mean(axis=0) for name, moves in lower.morphs.items()
        }
        self.layers = (
            _shaded_part(photo, tongue, jaw_px, "tongue_alveolar"),
            _shaded_part(photo, lower, jaw_px),
            _shaded_part(photo, tongue, jaw_px, "tongue_dental"),
            _shaded_part(photo, parts["teeth_upper"], {}),
        )
        # The rim runs from a corner over the upper lip to the other, and back along the lower.
        half = len(lips_px) // 2
        self.upper_rows = np.arange(half + 1)
        self.lower_rows = np.concatenate([np.arange(half, len(lips_px)), [0]])[::-1]
        # Lips that are closed in the photograph have a line of their own where they meet.
        between = lips_px[self.lower_rows, :2] - lips_px[self.upper_rows, :2]
        gaps_px = np.linalg.norm(between, axis=1)
        is_closed = float(gaps_px.max()) < _CLOSED_MM * photo.px_per_mm
        slit_px = SLIT_MM * photo.px_per_mm
        self.hidden_px = gaps_px + slit_px if is_closed else np.full(len(gaps_px), slit_px)


class MouthInside:
    """The drawn inside of the mouth of one photograph.

    lips_px (n, 3): the inner rim as photographed.
    """

    def __init__(self, photo: PhotoFace, lips_px: Array) -> None:
        """Draw teeth and tongue as sprites, once for all frames."""
        self._photo = photo
        parts = MouthParts(photo, lips_px)
        self._layers = [(part, _drawn_sprite(part)) for part in parts.layers]
        self._photographed = dict(zip(photo.twin.components, photo.own.tolist(), strict=True))
        self._tint = _tint(photo.picture, lips_px)
        self._upper_rows, self._lower_rows = parts.upper_rows, parts.lower_rows
        self._photographed_px, self._gap_px = lips_px[:, :2], parts.hidden_px

    def draw_into(
        self, picture: Picture, frame: Frame, lips_px: Array, turned: tuple[Array, Array]
    ) -> None:
        """Draw teeth, tongue and darkness into the opening between the inner lips of a picture.

        Parameters
        ----------
        picture : Picture
            (height, width, 3), changed in place.
        frame : Frame
            The mouth's coefficients.
        lips_px : Array
            (n, 3) pixels and depth, the inner rim as moved.
        turned : tuple[Array, Array]
            Rotation and shift of the head, in pixels, from `PhotoWarp.turn`.
        """
        import cv2

        # The rim of the lips in the picture.
        flat = lips_px[:, :2]
        # The part of the picture around the lips, as far as it lies in the picture.
        low = np.floor(flat.min(axis=0)).astype(int) - 2
        high = np.ceil(flat.max(axis=0)).astype(int) + 3
        height, width = picture.shape[:2]
        low, high = np.maximum(low, 0), np.minimum(high, (width, height))
        if (high <= low).any():
            return
        view = picture[low[1] : high[1], low[0] : high[0]]
        gaps = _Opening(flat, self._upper_rows, self._lower_rows, self._gap_px, low, view.shape[:2])
        if not gaps.hole.any():
            return
        # The colour of the nearest point of the photographed lips.
        lips = cv2.remap(
            self._photo.picture, *gaps.nearest_lip(self._photographed_px), cv2.INTER_LINEAR
        ).astype(np.float32)
        inside = self._inside(frame, turned, low, view.shape[:2], gaps)
        open_share = gaps.cover[..., None]
        # Lips that hardly part are seen through nothing: what is between them is their own shade.
        parted = np.clip(gaps.open_px / (PARTED_MM * self._photo.px_per_mm), 0.0, 1.0)[..., None]
        inside = parted * inside + (1 - parted) * (SHADE * lips)
        # Pixels that the opening covers in part show the lips beside it.
        hole = gaps.hole[..., None]
        rim = hole * lips + (1 - hole) * view.astype(np.float32)
        view[...] = np.clip(open_share * inside + (1 - open_share) * rim, 0, 255).astype(np.uint8)

    def _inside(
        self,
        frame: Frame,
        turned: tuple[Array, Array],
        low: NDArray[np.int_],
        shape: tuple[int, int],
        gaps: "_Opening",
    ) -> Pixels:
        """Return teeth and tongue before darkness, shaded: float32 (rows, columns, 3), 255 full.

        turned: rotation and shift of the head. low: (column, row) of the view's corner in the
        picture; shape: its rows and columns. gaps: the lips' opening in the view, which sets the
        light.
        """
        amounts = amounts_of(frame, self._photo.twin.components)
        pixels = np.broadcast_to(DARKNESS, (*shape, 3)).astype(np.float32)
        for part, sprite in self._layers:
            # A tongue comes up from below, and out of the dark.
            shown = amounts.get(part.raised_by, 1.0)
            if not shown:
                continue
            moved = np.zeros(3)
            for name, way_px in part.moves_px.items():
                moved = moved + (amounts[name] - self._photographed.get(name, 1.0)) * way_px
            placed = _placed_sprite(sprite, turned, moved, low, shape)
            cover = shown * placed[..., 3:]
            pixels = cover * placed[..., :3] + (1 - cover) * pixels
        gap_mm = gaps.widest_px / self._photo.px_per_mm
        share = np.clip((gap_mm - DARK_MM) / (LIGHT_MM - DARK_MM), 0.0, 1.0)
        light = LEAST_LIGHT + (1 - LEAST_LIGHT) * share * share * (3 - 2 * share)
        shadow = 0.45 + 0.55 * np.clip(
            gaps.below_upper_px / (SHADOW_MM * self._photo.px_per_mm), 0.0, 1.0
        )
        return np.asarray(pixels * (light * shadow[..., None]) * self._tint, dtype=np.float32)


class _Opening:
    """The opening between the inner lips, as seen by each pixel of a view of a picture.

    hole: open share of each pixel, 0 to 1; cover: the same without the gap that shows nothing.
    open_px, widest_px: height of the visible opening at each pixel, and the largest.
    below_upper_px: distance of each pixel from the upper edge of the visible opening.
    """

    def __init__(
        self,
        lips: Array,
        upper_rows: NDArray[np.int_],
        lower_rows: NDArray[np.int_],
        hidden_px: Array,
        low: NDArray[np.int_],
        shape: tuple[int, int],
    ) -> None:
        """Measure the opening between moved lips.

        lips (n, 2): the inner rim in px of the picture; upper_rows, lower_rows: as in `MouthParts`.
        hidden_px (n_pairs,): gaps up to which nothing is seen. low: (column, row) of the view's
        corner in the picture; shape: its rows and columns.
        """
        corner, other = lips[upper_rows[0]], lips[upper_rows[-1]]
        # s, t: coordinates of each pixel in px, along the line between the mouth's corners and down
        # from it.
        along = (other - corner) / max(float(np.linalg.norm(other - corner)), 1e-9)
        self._axes = np.array([along, [-along[1], along[0]]])
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        from_corner = np.stack([columns + low[0], rows + low[1]], axis=-1) - corner
        s, t = (from_corner @ self._axes.T).transpose(2, 0, 1)
        self._upper, self._lower = upper_rows, lower_rows
        # The lips as curves in these coordinates, and their heights t at each pixel's s.
        chains = [(lips[each] - corner) @ self._axes.T for each in (upper_rows, lower_rows)]
        self._s = [np.maximum.accumulate(chain[:, 0]) for chain in chains]
        top, bottom = (
            np.interp(s, at_s, chain[:, 1]) for at_s, chain in zip(self._s, chains, strict=True)
        )
        within = (s >= self._s[0][0]) & (s <= self._s[0][-1])
        # Which share of each pixel's height lies between the lips.
        open_px = np.minimum(t + 0.5, bottom) - np.maximum(t - 0.5, top)
        self.hole = np.where(within, np.clip(open_px, 0.0, 1.0), 0.0).astype(np.float32)
        # The same without the part, next to both lips, that shows nothing.
        margin = np.interp(s, self._s[0], hidden_px) / 2
        top, bottom = top + margin, bottom - margin
        open_px = np.minimum(t + 0.5, bottom) - np.maximum(t - 0.5, top)
        self.cover = np.where(within, np.clip(open_px, 0.0, 1.0), 0.0).astype(np.float32)
        self.open_px = np.maximum(0.0, bottom - top)
        self.widest_px = float(np.max(np.where(within, bottom - top, 0.0)))
        self.below_upper_px = t - top
        self._along, self._is_upper = s, (t - top) < (bottom - t)

    def nearest_lip(self, rest_px: Array) -> tuple[Pixels, Pixels]:
        """Return for each pixel of the view a point on the rim of the lip nearer to the pixel.

        The point is where that rim, in the view, crosses the line through the pixel at right angles
        to the line between the mouth's corners. Returned are x and y, two arrays of the view's
        shape, of the same point of the lip as photographed. rest_px (n, 2): the lip points in the
        photograph, in the order of the constructor's `lips`.
        """
        coordinates = []
        for axis in (0, 1):
            upper, lower = (
                np.interp(self._along, at_s, rest_px[rows, axis])
                for at_s, rows in zip(self._s, (self._upper, self._lower), strict=True)
            )
            coordinates.append(np.where(self._is_upper, upper, lower).astype(np.float32))
        return coordinates[0], coordinates[1]


def _placed_sprite(
    sprite: _Sprite,
    turned: tuple[Array, Array],
    moved_px: Array,
    low: NDArray[np.int_],
    shape: tuple[int, int],
) -> Pixels:
    """Return a sprite's pixels in a view of `shape` whose corner is at `low` in the picture.

    moved_px: (3,), by which the sprite is moved before it turns with the head. turned: rotation and
    shift of the head. Where the sprite is not, pixels are 0.
    """
    import cv2

    turn, shift = turned
    corner = turn @ (sprite.corner_px + moved_px) + shift
    # The matrix takes pixels of the sprite, drawn three times as large, to pixels of the view.
    linear = turn[:2, :2] / _FINE
    half = (_FINE - 1) / 2.0
    matrix = np.column_stack([linear, corner[:2] - linear @ (half, half) - low])
    pixels = cv2.warpAffine(sprite.pixels, matrix, shape[::-1], flags=cv2.INTER_LINEAR)
    return np.asarray(pixels, dtype=np.float32)


def _shaded_part(
    photo: PhotoFace, part: Part, jaw_px: dict[str, Array], raised_by: str = ""
) -> SeenPart:
    """Return a part of the twin, the program's own head, shaded, in the photograph's pose.

    jaw_px: by target, how far the amount 1 of it moves the jaw, and so the part. raised_by: a
    further target that moves the part, shown in full; its tip counts.
    """
    amounts = dict(zip(photo.twin.components, photo.own.tolist(), strict=True)) | {raised_by: 1.0}
    places_mm = part.places_mm.copy()
    for name, moves in part.morphs.items():
        places_mm += amounts.get(name, 0.0) * moves
    if raised_by:
        tip = int(np.argmax(part.places_mm[:, 2]))
        jaw_px = jaw_px | {raised_by: photo.matrix @ part.morphs[raised_by][tip]}
    px = photo.in_picture(places_mm)
    facing_light = np.clip(vertex_normals(places_mm, part.triangles) @ _LIGHT, 0.0, 1.0)
    # Farther back in the mouth it is darker.
    depth_mm = places_mm[:, 2].max() - places_mm[:, 2]
    light = (0.55 + 0.45 * facing_light) * np.exp(-depth_mm / 24.0)
    order = np.argsort(px[part.triangles, 2].mean(axis=1))
    colours = 255.0 * part.colours * light[:, None]
    return SeenPart(px, colours, part.triangles[order], jaw_px, raised_by)


def _drawn_sprite(part: SeenPart) -> _Sprite:
    """Return a part of the head drawn as a small picture, with softened edges."""
    import cv2

    px = part.places_px
    low = np.append(np.floor(px[:, :2].min(axis=0)) - 1, px[:, 2].max())
    fine = (px[:, :2] - low[:2]) * _FINE + (_FINE - 1) / 2.0
    width, height = (np.ceil(fine.max(axis=0)) + 2 * _FINE).astype(int).tolist()
    corners = fine[part.triangles]
    covered_pixels = covered(corners, height, width)
    colours = covered_pixels.interpolated(corners, part.colours[part.triangles]).T
    pixels = np.zeros((height, width, 4), dtype=np.float32)
    pixels[covered_pixels.rows, covered_pixels.columns, :3] = colours
    pixels[covered_pixels.rows, covered_pixels.columns, 3] = 1.0
    blurred = np.asarray(cv2.blur(pixels, (_FINE, _FINE)), dtype=np.float32)
    # The blur has mixed in the empty pixels' black: undo that for the colours.
    blurred[..., :3] /= np.maximum(blurred[..., 3:], 1e-6)
    return _Sprite(blurred.astype(np.float32), low)


def _tint(picture: Picture, lips_px: Array) -> Pixels:
    """Return the colour of the photograph's light at the lips, (3,), relative to white."""
    height, width = picture.shape[:2]
    low = np.clip(np.floor(lips_px[:, :2].min(axis=0)).astype(int) - 10, 0, None)
    high = np.clip(np.ceil(lips_px[:, :2].max(axis=0)).astype(int) + 10, None, (width, height))
    around = picture[low[1] : high[1], low[0] : high[0]].reshape(-1, 3).astype(np.float64)
    bright_colour = np.percentile(around, 85, axis=0)
    grey = float(bright_colour.mean())
    level = np.clip(grey / 185.0, 0.45, 1.1)
    # Of the light's colour only a little: skin is red under white light too.
    hue = 1.0 + 0.15 * (bright_colour / max(grey, 1.0) - 1.0)
    return np.asarray(level * hue, dtype=np.float32)
