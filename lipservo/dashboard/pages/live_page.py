"""The live page: the face that was asked for, the robot as its encoders say, sound and phonemes."""

from html import escape
from typing import Final

from nicegui import ui

from lipservo.dashboard.pages.page_facts import GROUPS
from lipservo.dashboard.pages.page_frame import card, grid, html
from lipservo.dashboard.twin.element import Twin
from lipservo.dashboard.twin.routes import HEAD_PATH

SCRIPTS: Final = (
    "live/twin_feed.js",
    "live/timeline.js",
    "live/waveform.js",
    "live/servo_bars.js",
    "live/robot_view.js",
    "live/live_facts.js",
    "live/say_box.js",
    "live/look_pad.js",
)


#: What the twin needs, asked for at once: the framework comes to it last.
_EARLY: Final = f'''<link rel="preload" href="{HEAD_PATH}" as="fetch" crossorigin>
<script type="module" async>
import {{ beginPicture }} from "lipservo-twin";
beginPicture("{HEAD_PATH}");
</script>'''


def live_page() -> None:
    """Its content."""
    ui.add_head_html(_EARLY)
    with grid("live-top"):
        with card("The face", "as it is asked to be", "twin"):
            Twin().classes("drawn")
        with card("The robot", "as its encoders say", "robot"):
            html("<face-robot></face-robot>")
        with card("Now", classes="now"):
            html("<face-facts></face-facts>")
    with card("Sound and phonemes", "the last seconds; now is at the right", "sound"):
        html("<face-timeline></face-timeline><face-waveform></face-waveform>" + _legend())
    with grid("live-bottom"):
        with card("Servos", "blue: where it is; orange: where it should be", "bars"):
            html("<face-servo-bars></face-servo-bars>")
        with grid("live-side"):
            with card("Say", classes="say"):
                html("<face-say></face-say>")
            with card("Look", "drag, and the robot looks there", "look"):
                html("<face-look></face-look>")


def _legend() -> str:
    entries = (
        f'<span><i style="background:{fill}"></i>{escape(word)}</span>'
        for word, fill, _, _ in GROUPS.values()
    )
    return f'<div class="legend">{"".join(entries)}</div>'
