"""The page for an audience: the face large, its mouth close up, and the robot by its own model."""

from typing import Final

from nicegui import ui

from lipservo.dashboard.pages.page_frame import STATIC_URL, card, grid, html
from lipservo.dashboard.twin.element import Twin

SHOW_SCRIPTS: Final = (
    "live/twin_feed.js",
    "show/close_up.js",
    "show/photograph.js",
    "show/own_robot.js",
    "show/trace_player.js",
)


def show_page() -> None:
    """Draw the audience page's content: the face, the robot's own model, and a recorded run."""
    ui.add_head_html(f'<link rel="stylesheet" href="{STATIC_URL}/show/show.css">')
    with grid("show-page"):
        with card("The face", "as it is asked to be", "twin"):
            html("<face-close-up></face-close-up>")
            html("<face-photo></face-photo>")
            Twin().classes("drawn head")
        with card("Your robot", "its own model, as its encoders say", "own-robot"):
            html("<face-model></face-model>")
    with card("A recorded run", "its trace, back and forth", "trace"):
        html("<face-trace></face-trace>")
