"""The live terminal view: which phoneme, how open the mouth, where each servo stands."""

from collections import deque
from collections.abc import Sequence

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from firmware_bridge.joints import Joint
from lipservo.mouth_drawing import MOUTH_COLUMNS, draw_mouth
from lipservo.pipeline import StreetTick
from lipsync.animpho.model import FaceModel
from lipsync.markers import LOWER_INNER_LIP, UPPER_INNER_LIP

_REFRESH_HZ = 10
_BAR_WIDTH = 31
_SHORTEST_NEEDLE = 9
#: "-12.3 deg" and the spaces between the columns.
_ANGLE_COLUMNS = 14
#: The mouth opens downwards: the closed one is drawn so far above the middle.
_LOOK_BELOW_MM = np.array([0.0, 8.0, 0.0])
#: A widely opened mouth; 99 % of the frames of grid_s1 stay below.
_WIDEST_GAP_MM = 18.0
_PHONEMES_SHOWN = 12


class TerminalView:
    """Keeps the newest tick; a thread of rich draws it ten times a second."""

    def __init__(
        self, console: Console, title: str, joints: Sequence[Joint], model: FaceModel
    ) -> None:
        self._title = title
        self._joints = joints
        self._model = model
        rest_mm = model.markers_mm(model.rest[None])[0]
        self._centre_mm = rest_mm[[UPPER_INNER_LIP, LOWER_INNER_LIP]].mean(axis=0) - _LOOK_BELOW_MM
        self._tick: StreetTick | None = None
        self._phonemes: deque[str] = deque(maxlen=_PHONEMES_SHOWN)
        self._live = Live(
            console=console, refresh_per_second=_REFRESH_HZ, get_renderable=self._draw
        )

    def observe(self, tick: StreetTick) -> None:
        """Show this tick at the next refresh."""
        if not self._phonemes or self._phonemes[-1] != tick.phoneme:
            self._phonemes.append(tick.phoneme)
        self._tick = tick

    def __enter__(self) -> "TerminalView":
        self._live.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._live.stop()

    def _draw(self) -> RenderableType:
        tick = self._tick
        if tick is None:
            return Text(self._title)
        gap_mm = self._model.lip_gap_mm(tick.coefficients)
        spoken = Text(" ".join(list(self._phonemes)[:-1]) + " ", style="dim")
        spoken.append(tick.phoneme, style="bold cyan")
        head = Table.grid(padding=(0, 2))
        head.add_row("sound", f"{max(0.0, tick.sound_s):6.2f} s")
        head.add_row("phonemes", spoken)
        head.add_row("lip gap", _bar(gap_mm / _WIDEST_GAP_MM), f"{gap_mm:5.1f} mm")
        servos = Table.grid(padding=(0, 1))
        name_width = max(len(joint.name) for joint in self._joints)
        room = self._live.console.width - MOUTH_COLUMNS - name_width - _ANGLE_COLUMNS
        width = min(max(room, _SHORTEST_NEEDLE), _BAR_WIDTH)
        for joint, sent_deg in zip(self._joints, tick.report.sent_deg, strict=True):
            where = (sent_deg - joint.min_deg) / (joint.max_deg - joint.min_deg)
            servos.add_row(joint.name, _needle(where, width), f"{sent_deg:6.1f} deg")
        torque = "" if tick.report.torque_on else "   torque off"
        markers_mm = self._model.markers_mm(tick.coefficients[None])[0]
        mouth = Text("\n".join(draw_mouth(markers_mm, self._centre_mm)), style="red")
        face = Table.grid(padding=(0, 1))
        face.add_row(mouth, servos)
        return Group(Text(self._title + torque, style="bold"), head, face)


def _bar(share: float) -> Text:
    """Filled from the left; share 0..1."""
    n = round(min(max(share, 0.0), 1.0) * _BAR_WIDTH)
    return Text("█" * n + "·" * (_BAR_WIDTH - n), style="red")


def _needle(share: float, width: int) -> Text:
    """One mark on a scale of `width` characters; share 0..1."""
    n = round(min(max(share, 0.0), 1.0) * (width - 1))
    text = Text("─" * n, style="dim")
    text.append("●", style="green")
    return text.append("─" * (width - 1 - n), style="dim")
