"""The page of single servos: how each is, torque and reboot, and moving one by hand."""

from typing import Final

from lipservo.dashboard.pages.page_frame import card, html

SCRIPTS: Final = ("servo_table.js", "jog.js")


def servos_page() -> None:
    """Its content."""
    with card("Health", "asked of one servo after the other, so a value may be a second old"):
        html("<face-servo-table></face-servo-table>")
    with card("Move by hand", classes="jog"):
        html("<face-jog></face-jog>")
