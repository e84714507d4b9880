"""What the terminal shows."""

import io
import re
from collections.abc import Sequence

import numpy as np
import pytest
from lipservo_lab.learning.motion.trained_model import load_trained_model
from rich.console import Console
from small_model import small_model

from firmware_bridge.gate.ramp import StaleLevel
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import TickReport
from lipservo.runtime.status.face_status import BridgeSide, SpeechStatus, Status
from lipservo.runtime.status.street_tick import StreetTick
from lipservo.terminal.view import TerminalView, draw_mouth
from lipsync.animpho.units import in_layout
from lipsync.face.frame import Frame
from lipsync.markers import MARKERS_39, MARKERS_47


def dots(lines: list[str]) -> np.ndarray:
    """(rows, columns): where a drawing is not empty."""
    return np.array([[char != "\u2800" for char in line] for line in lines])


@pytest.mark.parametrize("layout", [MARKERS_39, MARKERS_47], ids=lambda layout: layout.name)
def test_an_open_mouth_is_drawn_taller_than_a_closed_one_with_the_lips_of_its_layout(layout):
    model = in_layout(small_model(), layout)
    rest_mm = model.markers_mm(model.rest[None])[0]
    wide = model.markers_mm((model.rest + 40.0 * np.eye(5)[0])[None])[0]
    heights = [dots(draw_mouth(mm, rest_mm, layout)).any(axis=1).sum() for mm in (rest_mm, wide)]
    assert heights[1] > heights[0] > 2


def test_what_does_not_fit_is_left_out():
    far_mm = np.full((47, 3), 1e4)
    assert not dots(draw_mouth(far_mm, np.zeros((47, 3)), MARKERS_47)).any()


def test_at_rest_the_shipped_mouth_is_closed_straight_and_symmetrical():
    """The speaker's own lips are 0.7 mm apart at rest, and her head leans to one side."""
    model = load_trained_model()
    rest_mm = model.markers_mm(model.rest[None])[0]
    drawn = dots(draw_mouth(rest_mm, rest_mm, model.layout))
    heights = [np.flatnonzero(column) for column in drawn.T if column.any()]
    # Upper edge, the line between the lips, lower edge: all in the same row over the whole width.
    (line,) = set.intersection(*map(set, map(np.ndarray.tolist, heights[1:-1])))
    columns = np.flatnonzero(drawn.any(axis=0))
    assert abs((columns[0] + columns[-1]) / 2 - (drawn.shape[1] - 1) / 2) <= 1.0
    assert drawn[line, columns[1] : columns[-1]].all()


STATUS = Status(
    BridgeSide(name="face"),
    SpeechStatus(sound="clip", strategy="expected", recognizer="energy", fallback_level=2),
)
JOINTS = [Joint("jaw", 1, -2.0, 25.0, 300.0), Joint("lower_lip_right", 2, -40.0, 40.0, 300.0)]


def tick(phoneme: str, sent_deg: Sequence[float], coefficients: np.ndarray) -> StreetTick:
    """Return a tick at .5 s with a phoneme, goals (n_servos,) and a face; no limit was hit."""
    goals_deg, none = np.array(sent_deg), np.zeros(len(sent_deg), dtype=bool)
    report = TickReport(
        1.0, 0, 0.0 * goals_deg, goals_deg, 0.0, StaleLevel.FRESH, True, none, none, none
    )
    return StreetTick(0.5, phoneme, Frame(0.5, coefficients), report)


def console_of(width: int, encoding: str = "utf-8") -> tuple[Console, io.BytesIO]:
    written = io.BytesIO()
    file = io.TextIOWrapper(written, encoding=encoding, write_through=True)
    return Console(file=file, force_terminal=True, width=width, height=40), written


def shown(width: int, encoding: str = "utf-8", joints: Sequence[Joint] = JOINTS) -> str:
    """All that the view writes for one tick of a speaking mouth, and its end."""
    model = small_model()
    console, written = console_of(width, encoding)
    with TerminalView(console, lambda: STATUS, joints, model) as view:
        view.observe(tick("UW", [12.5, -33.3][: len(joints)], model.rest + 40.0 * np.eye(5)[0]))
        view._live.refresh()
    return written.getvalue().decode(encoding)


def test_the_view_shows_the_phoneme_every_servo_the_strategy_and_who_listens():
    screen = shown(100)
    for text in ("clip -> face", "UW", "jaw", "12.5 deg", "lower_lip_right", "-33.3 deg", "0.50 s"):
        assert text in screen
    assert "expected, energy, fallback 2" in screen


@pytest.mark.parametrize("width", [80, 60, 45, 30, 26])
def test_names_and_angles_are_whole_in_narrow_terminals(width):
    screen = shown(width)
    assert "lower_lip_right" in screen
    assert "-33.3 deg" in screen
    assert "\u2026" not in screen
    widest = max(map(len, re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen).splitlines()))
    assert widest <= width


def test_a_terminal_that_is_not_utf_8_gets_plain_characters():
    screen = shown(100, "ascii")  # would raise where a character cannot be written
    assert "---------" in screen
    assert "\\u" not in screen


def test_a_joint_that_cannot_move_is_shown_in_the_middle_of_its_scale():
    assert "12.5 deg" in shown(100, joints=[Joint("lid", 1, 0.0, 0.0, 300.0)])


def test_the_last_picture_is_the_mouth_at_rest():
    screen = shown(100)
    last = screen[screen.rindex("clip -> face") :]
    assert "SIL" in last
    assert "0.0 deg" in last
    assert "12.5 deg" not in last


def test_a_terminal_that_changes_its_size_is_cleared_before_the_next_picture():
    model = small_model()
    console, written = console_of(100)
    with TerminalView(console, lambda: STATUS, JOINTS, model) as view:
        view.observe(tick("UW", [0.0, 0.0], model.rest))
        view._live.refresh()
        assert _CLEARED not in written.getvalue()
        console.width = 70
        view._live.refresh()
        assert written.getvalue().count(_CLEARED) == 1
        view._live.refresh()
    assert written.getvalue().count(_CLEARED) == 1


#: ECMA-48: erase the page, and go to its first place.
_CLEARED = b"\x1b[2J\x1b[H"
