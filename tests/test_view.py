"""What the terminal shows."""

import io

import numpy as np
from rich.console import Console
from small_model import small_model

from firmware_bridge.bridge import TickReport
from firmware_bridge.joints import Joint
from firmware_bridge.safety import StaleLevel
from lipservo.mouth_drawing import draw_mouth
from lipservo.pipeline import StreetTick
from lipservo.view import TerminalView
from lipsync.markers import LOWER_INNER_LIP, UPPER_INNER_LIP


def dots(lines: list[str]) -> np.ndarray:
    """(rows, columns): where a drawing is not empty."""
    return np.array([[char != "\u2800" for char in line] for line in lines])


def test_an_open_mouth_is_drawn_taller_than_a_closed_one():
    model = small_model()
    heights = []
    for coefficients in (model.rest, model.rest + 40.0 * np.eye(5)[0]):
        markers_mm = model.markers_mm(coefficients[None])[0]
        centre_mm = markers_mm[[UPPER_INNER_LIP, LOWER_INNER_LIP]].mean(axis=0)
        drawn = dots(draw_mouth(markers_mm, centre_mm))
        heights.append(drawn.any(axis=1).sum())
    assert heights[1] > heights[0] > 2


def test_what_does_not_fit_is_left_out():
    far_mm = np.full((47, 3), 1e4)
    assert not dots(draw_mouth(far_mm, np.zeros(3))).any()


def test_the_view_shows_the_phoneme_and_every_servo():
    model = small_model()
    joints = [Joint("jaw", 1, -2.0, 25.0, 300.0), Joint("lip", 2, -10.0, 10.0, 300.0)]
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=120)
    none = np.zeros(2, dtype=bool)
    report = TickReport(
        1.0, 0, np.zeros(2), np.array([12.5, -3.0]), 0.0, StaleLevel.FRESH, True, none, none, none
    )
    with TerminalView(console, "clip -> face", joints, model) as view:
        view.observe(StreetTick(0.5, "UW", model.rest, report))
    for text in ("clip -> face", "UW", "jaw", "12.5 deg", "lip", "-3.0 deg", "0.50 s"):
        assert text in screen.getvalue()


def test_nothing_is_cut_off_in_a_terminal_of_80_columns():
    model = small_model()
    joints = [Joint("lower_lip_right", 1, -40.0, 40.0, 300.0)]
    screen = io.StringIO()
    none = np.zeros(1, dtype=bool)
    report = TickReport(
        1.0, 0, np.zeros(1), np.array([-33.3]), 0.0, StaleLevel.FRESH, True, none, none, none
    )
    console = Console(file=screen, force_terminal=True, width=80)
    with TerminalView(console, "clip -> face", joints, model) as view:
        view.observe(StreetTick(0.5, "UW", model.rest, report))
    assert "lower_lip_right" in screen.getvalue()
    assert "-33.3 deg" in screen.getvalue()
    assert "…" not in screen.getvalue()
