"""The page of settings: how strongly, smoothly, early and lively the face moves."""

from typing import Final

from lipservo.dashboard.pages.page_frame import card, grid, html

SCRIPTS: Final = ("settings.js", "live/robot_view.js")


def settings_page() -> None:
    """Its content. The robot is beside the sliders, so that one sees what they do."""
    with grid("settings-page"):
        with card("Motion", "changes at once, for as long as the face runs", "settings"):
            html("<face-settings></face-settings>")
        with card("The robot", "as its encoders say", "robot"):
            html("<face-robot></face-robot>")
