"""A drawing of a robot from the front at given servo angles: the dashboard's, as pixels.

Geometry, directions and colours are those of lipservo/dashboard/static/live/robot_figure.js: horns
of 8 mm at the lips, the jaw hinged 88 mm behind the incisors.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.calibration import Calibration
from lipservo.dashboard.pages.page_facts import RigServo, robot_rig
from lipservo.runtime.servos.assembly import Face
from lipservo.runtime.speech.expression import ExpressionClaims, expression_servos
from lipservo.runtime.speech.layers import Layer
from lipsync.arrays import Array
from lipsync.errors import check_extra
from lipsync.face.frame import Frame
from lipsync.video.face_detection import Picture

Colour = tuple[int, int, int]
#: The drawing has units of its own, like the dashboard's: so many for a millimetre of the robot,
#: and width and height of the whole field.
_UNIT, _FIELD = 2.6, (400.0, 440.0)
_HORN_MM, _JAW_MM = 8.0, 88.0
_MOUTH_AT, _HALF_MM, _INNER_MM = np.array([200.0, 280.0]), 27.0, 11.0
_EYES_Y, _EYES_APART, _EYE_RADIUS, _IRIS = 165.0, 52.0, 27.0, 12.0
_FIELD_COLOUR, _SKULL, _JAW, _LINE = (
    (246, 248, 250),
    (233, 238, 242),
    (211, 219, 226),
    (125, 139, 151),
)
_CAVITY, _TEETH, _LIPS, _LIP_LINE = (42, 26, 30), (247, 244, 234), (181, 82, 92), (128, 48, 59)
_WHITE, _IRIS_COLOUR, _PUPIL, _LID = (255, 255, 255), (31, 95, 153), (16, 16, 18), (195, 204, 212)
_LIP_BULGE = np.array([0.15, 0.9, 0.82, 0.9, 0.15])
#: OpenCV draws at fractions of a pixel: so many bits of them.
_BITS = 4


class RobotDisplay:
    """A drawing of a face's robot, for frames or for angles of its servos. Needs OpenCV."""

    def __init__(self, face: Face, size: tuple[int, int], period_s: float) -> None:
        """Prepare the drawing. face: the robot's settings and calibration.

        size: width, height in px; period_s: time between two frames.
        """
        check_extra("cv2", "drawing a robot")
        self._size = size
        self._rig = robot_rig(face.settings.servos)
        self._names = list(face.settings.servos)
        self._calibration: Calibration = face.calibration
        self._mouth = [self._names.index(name) for name in face.settings.mouth_servos]
        self._head = ExpressionClaims(expression_servos(face.settings), period_s)
        self._scale = min(size[0] / _FIELD[0], size[1] / _FIELD[1])
        self._shift = (np.array(size) - self._scale * np.array(_FIELD)) / 2

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self._size

    def draw(self, frame: Frame) -> Picture:
        """Return a picture of the robot with its servos at the angles for a frame."""
        positions_deg = np.zeros(len(self._names))
        positions_deg[self._mouth] = self._calibration.positions_deg(frame.coefficients)
        for claim in self._head.claims(frame.expression, Layer.EXPRESSION):
            positions_deg[claim.servos] = claim.positions_deg
        return self.draw_angles(self._names, positions_deg)

    def draw_angles(self, names: Sequence[str], positions_deg: Array) -> Picture:
        """Return a picture of the robot with its servos at the given angles.

        Parameters
        ----------
        names : Sequence[str]
            Names of n servos.
        positions_deg : Array
            (n,) degrees.

        Returns
        -------
        Picture
            (height, width, 3).
        """
        moved = moved_channels(self._rig, dict(zip(names, positions_deg.tolist(), strict=True)))
        canvas = _Canvas(self._size, self._scale, self._shift, moved)
        canvas.head(bool({"eye_yaw", "eye_pitch", "lid"} & {channel for channel, _ in moved}))
        canvas.mouth()
        return canvas.picture


def moved_channels(
    rig: Mapping[str, RigServo], positions_deg: Mapping[str, float]
) -> dict[tuple[str, str], float]:
    """Return degrees by (channel, side), in the drawing's directions, from angles of servos.

    A channel is a motion of the drawing, such as `jaw`; sides are "left" and "right". Servos
    without a channel in `rig` are left out.
    """
    degrees: dict[tuple[str, str], float] = {}
    for name, deg in positions_deg.items():
        servo = rig.get(name)
        if servo is None or servo.channel is None:
            continue
        sides = ("left", "right") if servo.side == "both" else (servo.side,)
        degrees |= {(servo.channel, side): servo.sign * deg for side in sides}
    return degrees


class _Canvas:
    """A picture on which the robot is drawn. moved: degrees by (channel, side)."""

    def __init__(
        self,
        size: tuple[int, int],
        scale: float,
        shift: Array,
        moved: Mapping[tuple[str, str], float],
    ) -> None:
        """Begin a picture of `size` (width, height), in px, with an empty field.

        scale, shift: from units of the drawing to pixels. moved: degrees by (channel, side), in the
        drawing's directions.
        """
        self.picture: Picture = np.full((size[1], size[0], 3), _FIELD_COLOUR, dtype=np.uint8)
        self._channel_deg, self._scale, self._shift = moved, scale, shift
        yaw, pitch, roll = (self._deg(f"neck_{axis}", "left") for axis in ("yaw", "pitch", "roll"))
        yaw_share, pitch_share = np.sin(np.radians([yaw, pitch]))
        turn = np.radians(roll)
        self._turn = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        self._skull_shift = np.array([26.0 * yaw_share, -22.0 * pitch_share])
        self._feature_shift = np.array([44.0 * yaw_share, -38.0 * pitch_share])
        self._narrowing = np.array([np.cos(np.radians(yaw)), 1.0])

    def head(self, has_eyes: bool) -> None:
        """Draw neck, skull, nose and brows, and eyes if `has_eyes`."""
        self._fill(_box(158, 330, 84, 88), _JAW, _LINE, "field")
        self._fill(np.array([[128, 408], [272, 408], [286, 430], [114, 430]]), _JAW, _LINE, "field")
        jaw_units = _UNIT * self._jaw_mm
        jaw = np.array([[104, 214], [106, 292], [124, 336], [162, 356], [200, 362]], dtype=float)
        jaw = np.vstack([jaw, (400.0, 0.0) + jaw[-2::-1] * (-1.0, 1.0)])
        self._fill(_curve(jaw) + np.array([0.0, jaw_units]), _JAW, _LINE, "skull")
        half = np.array([[200, 32], [262, 52], [303, 108], [313, 166], [309, 220], [296, 262],
                         [272, 284], [236, 292]], dtype=float)  # fmt: skip
        skull = np.vstack([half, (400.0, 0.0) + half[:0:-1] * (-1.0, 1.0)])
        self._fill(_curve(skull), _SKULL, _LINE, "skull")
        for ear_x in (103, 297):
            self._fill(_circle((ear_x, 226), 9.0), _JAW, _LINE, "skull")
        self._fill(np.array([[200, 188], [213, 234], [200, 239], [187, 234]]), _JAW, _LINE)
        for side, direction in (("right", -1.0), ("left", 1.0)):
            middle = np.array([200.0 + direction * _EYES_APART, _EYES_Y])
            if has_eyes:
                self._eye(side, middle)
            if ("brow", side) in self._channel_deg:
                up = -_UNIT * _horn_mm(self._deg("brow", side))
                brow = _curve(
                    middle + np.array([[-26, -39 + up], [0, -46 + up], [26, -39 + up]]),
                    closed=False,
                )
                self._line(brow, _LINE, 5.0)

    def _eye(self, side: str, middle: Array) -> None:
        """Draw an eye with iris, pupil and upper lid; `middle`: (2,) in drawing units."""
        self._fill(_circle(middle, _EYE_RADIUS), _WHITE, _LINE)
        look_share = np.sin(np.radians([self._deg("eye_yaw", side), -self._deg("eye_pitch", side)]))
        iris_middle = middle + 0.55 * _EYE_RADIUS * look_share / 0.5
        self._fill(_circle(iris_middle, _IRIS), _IRIS_COLOUR, None)
        self._fill(_circle(iris_middle, 5.5), _PUPIL, None)
        lid = self._channel_deg.get(("lid", side))
        # The covered share of the eye: 14 % at 0 degrees or without a servo, all at -45 degrees.
        shut = 0.14 if lid is None else 0.14 - 0.86 * lid / 45.0 if lid < 0 else 0.14 - lid / 90.0
        lid_y = middle[1] - _EYE_RADIUS + 2 * _EYE_RADIUS * min(1.0, max(0.0, shut))
        # The part of the eye's circle above the edge of the lid, from its right end over the top.
        edge_share = np.clip((lid_y - middle[1]) / _EYE_RADIUS, -1.0, 1.0)
        angle = np.linspace(np.arcsin(edge_share), -np.pi - np.arcsin(edge_share), 40)
        arc = np.column_stack([np.cos(angle), np.sin(angle)])
        self._fill(middle + _EYE_RADIUS * arc, _LID, _LINE)

    def mouth(self) -> None:
        """Draw lips, teeth and the cavity between the lips."""
        pout = min(1.0, max(-1.0, _horn_mm(self._deg("protrusion", "left")) / _HORN_MM))
        # Positions in mm from the middle of the closed mouth, x right and y down: of each lip its
        # middle and its two horns, and the corners.
        inner = _INNER_MM - 2 * pout
        jaw = self._jaw_mm
        corner = {
            side: (
                _HALF_MM + _horn_mm(self._deg("corner_out", side)) - 2 * pout,
                jaw / 2 - _horn_mm(self._deg("corner_up", side)),
            )
            for side in ("left", "right")
        }
        upper = {side: -_horn_mm(self._deg("upper_lip", side)) for side in ("left", "right")}
        lower = {side: jaw + _horn_mm(self._deg("lower_lip", side)) for side in ("left", "right")}
        ends = (-corner["right"][0], corner["right"][1]), corner["left"]
        upper_middle, lower_middle = sum(upper.values()) / 2, sum(lower.values()) / 2

        def chain(lip: Mapping[str, float], middle: float) -> Array:
            points = [ends[0], (-inner, lip["right"]), (0.0, middle), (inner, lip["left"]), ends[1]]
            return _MOUTH_AT + _UNIT * np.array(points)

        # The two edges of the opening; each lip is a band of some thickness outside its edge.
        above, below = chain(upper, upper_middle + 0.4), chain(lower, lower_middle)
        thick = _UNIT * (5 + 2.5 * pout)
        upper_edge = above - np.column_stack([np.zeros(5), thick * _LIP_BULGE])
        lower_edge = below + np.column_stack([np.zeros(5), 1.15 * thick * _LIP_BULGE])
        self._fill(_ring(above, below), _CAVITY, None)
        gap = max(0.0, lower_middle - upper_middle)
        xy = _MOUTH_AT + _UNIT * np.array([-9.0, min(upper_middle, 0.0)])
        self._fill(_box(xy[0], xy[1], _UNIT * 18, _UNIT * min(gap, 5.0)), _TEETH, None)
        # The lower teeth, up to 3.5 mm of them, in what is left of the opening.
        teeth_mm = max(0.0, min(gap - 5.0, 3.5))
        xy = _MOUTH_AT + _UNIT * np.array([-8.0, lower_middle - teeth_mm])
        self._fill(_box(xy[0], xy[1], _UNIT * 16, _UNIT * teeth_mm), _TEETH, None)
        self._fill(_ring(above, upper_edge), _LIPS, _LIP_LINE)
        self._fill(_ring(below, lower_edge), _LIPS, _LIP_LINE)

    @property
    def _jaw_mm(self) -> float:
        return _JAW_MM * float(np.sin(np.radians(self._deg("jaw", "left"))))

    def _deg(self, channel: str, side: str) -> float:
        return self._channel_deg.get((channel, side), 0.0)

    def _to_pixels(self, points: Array, on: str) -> Array:
        """Return the pixels (n, 2) of points (n, 2) in drawing units.

        on: with what the points turn: "face" (features of the face), "skull" or "field" (not at
        all).
        """
        xy = np.asarray(points, dtype=np.float64)
        # Features are narrowed about the middle of the face, x = 200, and moved as the head turns.
        if on == "face":
            xy = (xy - (200.0, 0.0)) * self._narrowing + (200.0, 0.0) + self._feature_shift
        # The skull moves less, and rolls about the neck at (200, 360).
        if on != "field":
            xy = (xy + self._skull_shift - (200.0, 360.0)) @ self._turn.T + (200.0, 360.0)
        return xy * self._scale + self._shift

    def _fill(self, points: Array, colour: Colour, line: Colour | None, on: str = "face") -> None:
        """Fill the polygon `points`, (n, 2) in drawing units.

        line: colour of the outline; None: no outline. on: with what the points turn, as for
        `_to_pixels`.
        """
        import cv2

        pixels = np.rint(self._to_pixels(points, on) * 2**_BITS).astype(np.int32)[None]
        cv2.fillPoly(self.picture, pixels, colour, cv2.LINE_AA, _BITS)
        if line is not None:
            width_px = max(1, round(1.6 * self._scale))
            cv2.polylines(self.picture, pixels, True, line, width_px, cv2.LINE_AA, _BITS)

    def _line(self, points: Array, colour: Colour, wide: float) -> None:
        """Draw an open line of `wide` drawing units through `points`, (n, 2), on the face."""
        import cv2

        pixels = np.rint(self._to_pixels(points, "face") * 2**_BITS).astype(np.int32)[None]
        width = max(1, round(wide * self._scale))
        cv2.polylines(self.picture, pixels, False, colour, width, cv2.LINE_AA, _BITS)


def _horn_mm(deg: float) -> float:
    return _HORN_MM * float(np.sin(np.radians(deg)))


def _box(x: float, y: float, wide: float, high: float) -> Array:
    return np.array([[x, y], [x + wide, y], [x + wide, y + high], [x, y + high]])


def _circle(middle: Array | tuple[float, float], radius: float) -> Array:
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    return np.asarray(middle + radius * np.column_stack([np.cos(angle), np.sin(angle)]))


def _ring(one: Array, other: Array) -> Array:
    return np.vstack([_curve(one, closed=False), _curve(other, closed=False)[::-1]])


def _curve(points: Array, *, closed: bool = True) -> Array:
    """Return points on a Catmull-Rom curve through `points`, (n, 2) -> (m, 2)."""
    before, after = (points[-1:], points[:2]) if closed else (points[:1], points[-1:])
    padded = np.vstack([before, points, after])
    u = np.linspace(0.0, 1.0, 8, endpoint=False)[:, None]
    pieces = []
    for point_before, start, end, point_after in zip(
        padded[:-3], padded[1:-2], padded[2:-1], padded[3:], strict=True
    ):
        slope_start, slope_end = (end - point_before) / 2, (point_after - start) / 2
        cubic = 2 * start - 2 * end + slope_start + slope_end
        square = -3 * start + 3 * end - 2 * slope_start - slope_end
        pieces.append(((cubic * u + square) * u + slope_start) * u + start)
    if not closed:
        pieces.append(points[-1:])
    return np.vstack(pieces)
