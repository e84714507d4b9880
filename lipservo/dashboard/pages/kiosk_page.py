"""The page for a kiosk: the face on the whole screen, what it says, STOP, and a box for a text."""

from typing import Final

from nicegui import ui

from lipservo.dashboard.pages.page_frame import STATIC_URL, grid, html
from lipservo.dashboard.twin.element import Twin

KIOSK_SCRIPTS: Final = ("live/twin_feed.js", "live/say_box.js", "kiosk/kiosk.js")


def kiosk_page() -> None:
    """Draw the kiosk's content; links and servos of the other pages are hidden by its styles."""
    ui.add_head_html(f'<link rel="stylesheet" href="{STATIC_URL}/kiosk/kiosk.css">')
    with grid("kiosk"):
        Twin().classes("drawn head")
        with grid("below"):
            html("<face-caption></face-caption>")
            html("<face-say></face-say>", "asks")
