"""The live terminal view: the current phoneme, the mouth's opening, each servo's angle.

The lips are a line drawing in Braille dots or plain characters: each lip marker's motion from rest
is added to a mouth that is closed, straight and symmetric, since a recorded speaker's own mouth at
rest is not.
"""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group, RenderableType
from rich.control import Control
from rich.live import Live
from rich.table import Table
from rich.text import Text

from firmware_bridge.joints import Joint
from lipservo.runtime.status.face_status import Status
from lipservo.runtime.status.street_tick import StreetTick
from lipsync.arrays import Array
from lipsync.face.frame import Frame
from lipsync.face.model import FaceModel
from lipsync.markers import INNER_LIP_GROUP, OUTER_LIP_GROUP, PointLayout
from lipsync.phonemes import SILENCE

Canvas = NDArray[np.int64]

#: Dots of a Braille character by column and row, as bits above U+2800 (Unicode, block Braille).
_DOT_BITS = np.array([[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]])
_UPPER_BITS = 0x01 | 0x02 | 0x08 | 0x10
_MM_PER_DOT = 1.1
MOUTH_COLUMNS, MOUTH_ROWS = 34, 12
#: Points along a line for each dot of its length, so that it has no holes.
_STEPS_PER_DOT = 2
#: The mouth opens downwards: the closed mouth is drawn so far above the canvas's middle.
_ABOVE_MIDDLE_MM = 8.0
_REFRESH_HZ = 10
_STATUS_EVERY_S = 1.0
_WIDEST_BAR = 31
_SHORTEST_BAR = 9
#: "-12.3 deg", and a space.
_ANGLE_COLUMNS = 10
_FEWEST_LETTERS = 4
#: "phonemes" and two spaces; "12.3 mm" and two.
_LABEL_COLUMNS, _GAP_COLUMNS = 10, 11
#: A widely opened mouth; 99 % of the frames of grid_s1 stay below.
_WIDEST_GAP_MM = 18.0
_PHONEMES_SHOWN = 12
#: So long the last picture may take: a terminal that takes no output must not delay the end.
_LAST_PICTURE_S = 0.5


def draw_mouth(
    markers_mm: Array, rest_mm: Array, layout: PointLayout, *, ascii_only: bool = False
) -> list[str]:
    """Return the lips from the front, drawn as text: outer and inner, or those in the layout.

    Parameters
    ----------
    markers_mm : Array
        (n_points, 3) mm.
    rest_mm : Array
        (n_points, 3) mm, the closed mouth of that speaker.
    layout : PointLayout
        Layout of the points.
    ascii_only : bool
        Whether to draw without Braille.

    Returns
    -------
    list[str]
        Lines of `MOUTH_COLUMNS` characters.
    """
    canvas = np.zeros((MOUTH_ROWS, MOUTH_COLUMNS), dtype=np.int64)
    # Outer and inner lips, each a closed polygon; an open mouth reaches down from the middle.
    for loop_mm in lip_loops_mm(markers_mm, rest_mm, layout):
        points_mm = loop_mm + np.array([0.0, _ABOVE_MIDDLE_MM])
        for start, end in pairwise([*points_mm, points_mm[0]]):
            _draw_line(canvas, start, end)
    character = _ascii if ascii_only else _braille
    return ["".join(character(int(cell)) for cell in row) for row in canvas]


def lip_loops_mm(markers_mm: Array, rest_mm: Array, layout: PointLayout) -> list[Array]:
    """Return the loops of outer and inner lips, or those in the layout, as seen from the front.

    At rest the lips are drawn closed and symmetric; motion from rest is added.

    Parameters
    ----------
    markers_mm,rest_mm : Array
        (n_points, 3) mm; the closed mouth of that speaker.
    layout : PointLayout
        Layout of the points.

    Returns
    -------
    list[Array]
        (n, 2) mm each, y upwards, from the middle of the mouth.
    """
    moved_mm = (markers_mm - rest_mm)[:, :2]
    return [at_rest_mm + moved_mm[loop] for loop, at_rest_mm in _neutral_lips(rest_mm, layout)]


def _neutral_lips(rest_mm: Array, layout: PointLayout) -> list[tuple[list[int], Array]]:
    """Return (marker indices, drawn positions at rest (n, 2) mm) of each loop: outer, inner lips.

    A loop that the layout lacks is left out. Positions are the mean of `rest_mm` and its mirror
    image, from the mouth's middle, with the inner lips in one straight line.
    """
    groups = [list(layout.group(name)) for name in (OUTER_LIP_GROUP, INNER_LIP_GROUP)]
    loops = [(points, _symmetrized(rest_mm[points, :2])) for points in groups if points]
    if not loops:
        return []
    # The innermost loop is the line where the lips meet.
    middle_mm = loops[-1][1][:, 1].mean()
    for _, points_mm in loops:
        # Both corners of the mouth, markers 0 and n / 2 of a loop, lie on the line, too.
        points_mm[:, 1] -= middle_mm
        points_mm[[0, len(points_mm) // 2], 1] = 0.0
    if groups[1]:
        loops[-1][1][:, 1] = 0.0
    return loops


def _symmetrized(points_mm: Array) -> Array:
    """Return the mean of a loop of the lips, (n, 2) mm, and its mirror image, (n, 2) mm, centred.

    Marker 0 is one corner of the mouth and n / 2 the other; marker k from the one, along the loop,
    mirrors marker k from the other, counted the other way round.
    """
    n = len(points_mm)
    mirrored = points_mm[(n // 2 - np.arange(n)) % n]
    return np.asarray((points_mm + mirrored * [-1.0, 1.0]) / 2.0)


def _braille(cell: int) -> str:
    return chr(0x2800 + cell)


def _ascii(cell: int) -> str:
    above, below = cell & _UPPER_BITS, cell & ~_UPPER_BITS
    return ":" if above and below else "'" if above else "." if below else " "


def _draw_line(canvas: Canvas, start: Array, end: Array) -> None:
    """Draw a line into the canvas, clipped; start, end: (2,) mm from the middle, y up."""
    # A character has 2 x 4 dots; the canvas's middle, in dots, is (MOUTH_COLUMNS, 2 * MOUTH_ROWS).
    dots = np.stack([start, end]) * [1.0, -1.0] / _MM_PER_DOT + [MOUTH_COLUMNS, 2 * MOUTH_ROWS]
    n_steps = int(np.abs(dots[1] - dots[0]).max() * _STEPS_PER_DOT) + 2
    for x, y in np.floor(np.linspace(dots[0], dots[1], n_steps)).astype(int):
        if 0 <= x < 2 * MOUTH_COLUMNS and 0 <= y < 4 * MOUTH_ROWS:
            canvas[y // 4, x // 2] |= _DOT_BITS[x % 2, y % 4]


@dataclass(frozen=True, slots=True)
class _Signs:
    """The characters of bars and scales."""

    full: str
    empty: str
    line: str
    mark: str


_UNICODE = _Signs("█", "·", "─", "●")
_ASCII = _Signs("#", ".", "-", "o")


class TerminalView:
    """A live view of the newest tick of the live loop, drawn ten times a second by rich's thread.

    If the `with` block ends without an error, the last picture is the mouth at rest.
    """

    def __init__(
        self,
        console: Console,
        status: Callable[[], Status],
        joints: Sequence[Joint],
        model: FaceModel,
    ) -> None:
        """Prepare the view. status: returns the face's status; `observe` calls it once a second.

        joints: those of all servos, in order.
        """
        self._get_status = status
        self._status = status()
        self._status_at_s = 0.0
        self._joints = joints
        self._model = model
        self._rest_mm = model.markers_mm(model.rest[None])[0]
        self._console = console
        self._signs = _ASCII if console.options.ascii_only else _UNICODE
        self._size = console.size
        self._tick: StreetTick | None = None
        self._phonemes: deque[str] = deque(maxlen=_PHONEMES_SHOWN)
        self._live = Live(
            console=console, refresh_per_second=_REFRESH_HZ, get_renderable=self._render
        )

    def observe(self, tick: StreetTick) -> None:
        """Store the newest tick, a step of the motion loop, for the next refresh to show."""
        if abs(tick.sound_s - self._status_at_s) >= _STATUS_EVERY_S:
            self._status_at_s = tick.sound_s
            self._status = self._get_status()
        if not self._phonemes or self._phonemes[-1] != tick.phoneme:
            self._phonemes.append(tick.phoneme)
        self._tick = tick

    def __enter__(self) -> "TerminalView":
        self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Draw the mouth at rest, unless an error ended the block, and end the drawing.

        Waits 0.5 s at most: a terminal that takes no output would block for ever.
        """
        tick = self._tick
        if tick is not None and kind is None:
            report = replace(tick.report, sent_deg=np.zeros(len(self._joints)))
            rest = Frame(tick.sound_s, self._model.rest)
            self.observe(replace(tick, phoneme=SILENCE, frame=rest, report=report))
        # In a thread, for rich's lock may be held by a picture that the terminal does not take.
        drawing = threading.Thread(target=self._live.stop, name="last picture", daemon=True)
        drawing.start()
        drawing.join(_LAST_PICTURE_S)

    def _render(self) -> RenderableType:
        """Return the picture of the newest tick for rich to print; before the first, the title.

        Called by rich's thread, ten times a second.
        """
        if self._console.size != self._size:
            # A terminal that is made narrower breaks the lines of the last picture.
            self._size = self._console.size
            self._console.control(Control.clear(), Control.home())
        tick = self._tick
        if tick is None:
            return Text(self._title)
        torque = {True: "", False: "   torque off", None: "   torque unknown"}
        title = Text(self._title + torque[tick.report.torque_on], style="bold")
        speech = self._status.speech
        fallback = f", fallback {speech.fallback_level}" if speech.fallback_level else ""
        stays_open = ", does not close" if speech.mouth_closes is False else ""
        motion = Text(f"{speech.strategy}, {speech.recognizer}{fallback}{stays_open}", style="dim")
        return Group(title, motion, self._status_rows(tick), self._mouth_and_servos(tick))

    @property
    def _title(self) -> str:
        return f"{self._status.speech.sound} -> {self._status.bridge.name}"

    def _status_rows(self, tick: StreetTick) -> Table:
        """Return three rows for a tick: sound time, the latest phonemes, lip gap."""
        gap_mm = self._model.lip_gap_mm(tick.coefficients)
        spoken = Text(" ".join(list(self._phonemes)[:-1]) + " ", style="dim")
        spoken.append(tick.phoneme, style="bold cyan")
        columns = self._console.width - _LABEL_COLUMNS
        spoken = spoken[-columns:] if len(spoken) > columns else spoken
        width = min(_WIDEST_BAR, columns - _GAP_COLUMNS)
        openness = self._bar(gap_mm / _WIDEST_GAP_MM, width).append(f"  {gap_mm:5.1f} mm")
        head = Table.grid(padding=(0, 2))
        hearing = "" if tick.hearing is None else f"   {tick.hearing}"
        head.add_row("sound", f"{max(0.0, tick.sound_s):6.2f} s{hearing}")
        head.add_row("phonemes", spoken)
        head.add_row("lip gap", openness)
        return head

    def _mouth_and_servos(self, tick: StreetTick) -> RenderableType:
        """Return the drawn mouth and the table of servos, side by side, for one tick.

        The table alone if the terminal is too narrow for both.
        """
        name_width = max(len(joint.name) for joint in self._joints)
        columns = self._console.width - name_width - _ANGLE_COLUMNS
        beside_mouth = columns - MOUTH_COLUMNS - 2
        if beside_mouth < _SHORTEST_BAR:
            return self._servo_table(tick, columns)
        markers_mm = self._model.markers_mm(tick.coefficients[None])[0]
        lines = draw_mouth(
            markers_mm, self._rest_mm, self._model.layout, ascii_only=self._signs is _ASCII
        )
        face = Table.grid(padding=(0, 1))
        face.add_row(Text("\n".join(lines), style="red"), self._servo_table(tick, beside_mouth))
        return face

    def _servo_table(self, tick: StreetTick, columns: int) -> Table:
        """Return a table with a line for each servo: name, scale of its range, goal in degrees.

        columns: characters for a space and the scale; if too few, the scale is left out, and names
        may be cut.
        """
        width = min(columns - 1, _WIDEST_BAR)
        n_letters = max(self._console.width - _ANGLE_COLUMNS, _FEWEST_LETTERS)
        servos = Table.grid(padding=(0, 1))
        for joint, sent_deg in zip(self._joints, tick.report.sent_deg, strict=True):
            row = [Text(joint.name[:n_letters]), Text(f"{sent_deg:5.1f} deg", no_wrap=True)]
            if width >= _SHORTEST_BAR:
                span_deg = joint.max_deg - joint.min_deg
                share = (sent_deg - joint.min_deg) / span_deg if span_deg else 0.5
                row.insert(1, self._scale(share, width))
            servos.add_row(*row)
        return servos

    def _bar(self, share: float, width: int) -> Text:
        """Return a bar of `width` characters, filled from the left by `share`, 0..1."""
        n_full = round(min(max(share, 0.0), 1.0) * max(width, 0))
        return Text(self._signs.full * n_full + self._signs.empty * (width - n_full), style="red")

    def _scale(self, share: float, width: int) -> Text:
        """Return a scale of `width` characters with a mark at `share`, 0..1."""
        n_before = round(min(max(share, 0.0), 1.0) * (width - 1))
        text = Text(self._signs.line * n_before, style="dim")
        text.append(self._signs.mark, style="green")
        return text.append(self._signs.line * (width - 1 - n_before), style="dim")
