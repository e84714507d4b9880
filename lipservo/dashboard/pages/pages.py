"""All pages of the dashboard, by path. What moves on them is drawn by the browser."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import nicegui.elements.echart  # noqa: F401  registers ECharts, which plots.js loads when opened
from nicegui import ui

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.pages.calibrate_page import calibrate_page, read_calibration
from lipservo.dashboard.pages.kiosk_page import KIOSK_SCRIPTS, kiosk_page
from lipservo.dashboard.pages.page_facts import GROUPS, page_facts
from lipservo.dashboard.pages.page_frame import (
    FIRST_HOUR,
    STATIC_URL,
    card,
    command,
    grid,
    html,
    page_frame,
)
from lipservo.dashboard.pages.show_page import SHOW_SCRIPTS, show_page
from lipservo.dashboard.twin.element import HEAD_PATH, Twin
from lipservo.settings.found_limits import WARNING

#: A slow telephone may take so long to load a page; the framework would load it anew after 3 s.
_RECONNECT_S: Final = 30.0
Status = Mapping[str, Any] | None
#: Fills a page: the face's newest status, and the config that it was started with.
Fill = Callable[[Status, str | None], Awaitable[None]]
_LIVE_SCRIPTS: Final = (
    "live/twin_feed.js", "live/timeline.js", "live/waveform.js", "live/servo_bars.js",
    "live/robot_view.js", "live/live_facts.js", "live/say_box.js", "live/sound_choice.js",
    "live/look_pad.js", "live/plots.js",
)  # fmt: skip


#: Requests what the twin (the drawn head) needs at once: the framework would load it last.
_TWIN_PRELOAD: Final = f'''<link rel="preload" href="{HEAD_PATH}" as="fetch" crossorigin>
<script type="module" async>
import {{ beginPicture }} from "lipservo-twin";
beginPicture("{HEAD_PATH}");
</script>'''
_FIRST_HOUR_SCRIPTS: Final = ("first_hour/first_hour.js", "live/robot_view.js", "live/say_box.js")
#: The command that starts a face which can play sound files.
COMMAND: Final = "lipservo daemon --config FACE --play --sounds FOLDER --dashboard"


def build_pages(link: FaceLink, new_config: Path | None = None) -> None:
    """Register all pages with NiceGUI. The browser draws what moves: a page needs no timer here.

    link: to the face; a page shows the face that answers when the page is opened. new_config: the
    YAML that the first hour writes, which need not exist yet; None: no page of the first hour.
    """
    _add_page(link, new_config, "/", _LIVE_SCRIPTS, _live)
    _add_page(link, new_config, "/show", SHOW_SCRIPTS, _show)
    _add_page(link, new_config, "/kiosk", KIOSK_SCRIPTS, _kiosk)
    _add_page(link, new_config, "/servos", ("servo_table.js", "jog.js"), _servos)
    _add_page(link, new_config, "/calibrate", (), _calibrate)
    _add_page(link, new_config, "/lines", ("lines.js",), _lines)
    _add_page(link, new_config, "/settings", ("settings.js", "live/robot_view.js"), _settings)
    if new_config is not None:
        _add_page(link, new_config, FIRST_HOUR, _FIRST_HOUR_SCRIPTS, _first_hour)


def _add_page(
    link: FaceLink, new_config: Path | None, path: str, scripts: Sequence[str], fill: Fill
) -> None:
    """Register one page at `path`, whose content `fill` draws.

    new_config: YAML of the face that is being set up, used for the page's facts while no face has
    answered; None: no face is being set up.
    """

    @ui.page(path, dark=None, reconnect_timeout=_RECONNECT_S)
    async def page() -> None:
        """Draw the page for one browser, with what is known of the face as the page is opened."""
        status = link.status
        config = None if status is None else status.get("config")
        if config is None and new_config is not None and new_config.exists():
            config = str(new_config)
        facts = await asyncio.to_thread(page_facts, config)
        facts["firstHour"] = new_config is not None
        with page_frame(path, status, facts, scripts):
            await fill(status, config)


async def _first_hour(_status: Status, _config: str | None) -> None:
    """Draw the page that leads a user from unnamed servos to the face's first words."""
    ui.add_head_html(f'<link rel="stylesheet" href="{STATIC_URL}/first_hour/first_hour.css">')
    html(f"<first-hour data-warning='{escape(WARNING)}'></first-hour>")


async def _calibrate(_status: Status, config: str | None) -> None:
    calibrate_page(config, *await asyncio.to_thread(read_calibration, config))


async def _live(_status: Status, _config: str | None) -> None:
    """Draw the live page: text to say, face as commanded, robot as measured, sound, phonemes."""
    ui.add_head_html(_TWIN_PRELOAD)
    with card("Say something", classes="say"):
        html("<face-say></face-say><face-sound></face-sound>")
    with grid("live-top"):
        with card("The face", "planned", "twin"):
            Twin().classes("drawn")
        with card("The robot", "where its servos are", "robot"):
            html("<face-robot></face-robot>")
        with card("Now", classes="now"):
            html("<face-facts></face-facts>")
    with card("Sound and phonemes", "the last seconds; now is at the right", "sound"):
        html("<face-timeline></face-timeline><face-waveform></face-waveform>" + _legend_html())
    with grid("live-bottom"):
        with card("Servos", "blue: where it is; orange: where it should be", "bars"):
            html("<face-servo-bars></face-servo-bars>")
        with card("Look", "drag, and the robot looks there", "look"):
            html("<face-look></face-look>")
    with card("The last minute", "plots", "minute"):
        html("<face-plots></face-plots>")


async def _show(_status: Status, _config: str | None) -> None:
    ui.add_head_html(_TWIN_PRELOAD)
    show_page()


async def _kiosk(_status: Status, _config: str | None) -> None:
    ui.add_head_html(_TWIN_PRELOAD)
    kiosk_page()


def _legend_html() -> str:
    entries = (
        f'<span><i style="background:{fill}"></i>{escape(text)}</span>'
        for text, fill, _, _ in GROUPS.values()
    )
    return f'<div class="legend">{"".join(entries)}</div>'


async def _servos(_status: Status, _config: str | None) -> None:
    """Draw the page of servos: a table of their health, with switches, and sliders to jog them."""
    with card("Health", "read from one servo after the other, so a value may be a second old"):
        html("<face-servo-table></face-servo-table>")
    with card("Move by hand", classes="jog"):
        html(f"<face-jog data-warning='{escape(WARNING)}'></face-jog>")


async def _lines(status: Status, _config: str | None) -> None:
    """Draw the page of sounds and performances that the face can play, else how to add some."""
    folder = (status or {}).get("sounds")
    hint = f"sound files in {folder}" if folder else ""
    with card("Lines", hint, "lines"):
        if folder:
            html("<face-lines></face-lines>")
        else:
            html(_no_folder_html(), "empty")


def _no_folder_html() -> str:
    return (
        "<p>This face has no folder of sound files, or no voice to speak them with.</p>"
        f"<p>Start it with one:</p>{command(COMMAND)}"
        "<p>WAV, FLAC, OGG and MP3 files of that folder, and performances, appear here, to be "
        "played, uploaded and deleted.</p>"
    )


async def _settings(_status: Status, _config: str | None) -> None:
    """Draw the page of motion settings: strength, smoothness, look-ahead, liveliness.

    The robot is drawn beside the sliders, to show their effect.
    """
    with grid("settings-page"):
        with card("Motion", "changes at once, for as long as the face runs", "settings"):
            html("<face-settings></face-settings>")
        with card("The robot", "as its encoders say", "robot"):
            html("<face-robot></face-robot>")
