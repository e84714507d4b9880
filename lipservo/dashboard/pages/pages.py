"""All pages, by their paths."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Final

from nicegui import ui

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.pages import (
    calibrate_page,
    lines_page,
    live_page,
    servos_page,
    settings_page,
)
from lipservo.dashboard.pages.page_facts import page_facts
from lipservo.dashboard.pages.page_frame import page_frame

#: A slow telephone may take so long to load a page; the framework would load it anew after 3 s.
_PATIENCE_S: Final = 30.0
Status = Mapping[str, Any] | None
#: Fills a page: the face's newest status, and the config that it was started with.
Fill = Callable[[Status, str | None], Awaitable[None]]


def build_pages(link: FaceLink) -> None:
    """Register them with NiceGUI. What moves is drawn by the browser: a page costs no timer here.

    link: the face; a page that is opened is told of the face that answers then.
    """
    _add(link, "/", live_page.SCRIPTS, _live)
    _add(link, "/servos", servos_page.SCRIPTS, _servos)
    _add(link, "/calibrate", (), _calibrate)
    _add(link, "/lines", lines_page.SCRIPTS, _lines)
    _add(link, "/settings", settings_page.SCRIPTS, _settings)


def _add(link: FaceLink, path: str, scripts: Sequence[str], fill: Fill) -> None:
    @ui.page(path, dark=False, reconnect_timeout=_PATIENCE_S)
    async def page() -> None:
        status = link.status
        config = None if status is None else status.get("config")
        facts = await asyncio.to_thread(page_facts, config)
        with page_frame(path, status, facts, scripts):
            await fill(status, config)


async def _live(_status: Status, _config: str | None) -> None:
    live_page.live_page()


async def _servos(_status: Status, _config: str | None) -> None:
    servos_page.servos_page()


async def _calibrate(_status: Status, config: str | None) -> None:
    found = await asyncio.to_thread(calibrate_page.read_calibration, config)
    calibrate_page.calibrate_page(config, *found)


async def _lines(status: Status, _config: str | None) -> None:
    lines_page.lines_page(status)


async def _settings(_status: Status, _config: str | None) -> None:
    settings_page.settings_page()
