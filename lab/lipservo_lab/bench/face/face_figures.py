"""Everything that `lipservo bench face` prints.

How long the page takes until it shows the face, in a browser that draws in software.

A head that runs with its page, as a user starts it.
"""

import asyncio
import itertools
import json
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any, Final

from websockets.asyncio.client import ClientConnection, connect

from lipservo.terminal.output import Advance
from lipservo_lab.bench.face.streams import stream_figures
from lipservo_lab.evaluation.expression.expression_figures import expression_figures
from lipservo_lab.own_processes import started
from lipsync.audio.file import FileSource
from lipsync.expression.live_expression import LiveExpression
from lipsync.prosody.voice_frame import VoiceFrame
from lipsync.prosody.voice_tracker import VoiceTracker

_NAMES: Final = ("chromium", "chromium-browser", "google-chrome")
_FLAGS: Final = (
    "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--remote-debugging-port=0", "--no-first-run",
    "--disable-background-networking", "--window-size=1280,800",
)  # fmt: skip
#: The head was drawn, and it moves.
READY: Final = "Boolean(window.twin && window.twin.ready && window.twin.frames > 0)"
_LOOK_S: Final = 0.02
_PATIENCE_S: Final = 60.0


def browser() -> str | None:
    """Return the path of a Chromium; None: none is installed."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


def page_ready_s(address: str, times: int = 3, ready: str = READY) -> float | None:
    """Return the median time from a page's request until it is ready, s; None without a Chromium.

    address: the page's URL. times: number of loads, each in a new browser with an empty cache,
    whose start does not count. ready: JavaScript that is true once the page is ready. Raises
    TimeoutError.
    """
    program = browser()
    if program is None:
        return None
    return asyncio.run(_median_ready_s(program, address, times, ready))


async def _median_ready_s(program: str, address: str, times: int, ready: str) -> float:
    """Return the median time from a request of a page until `ready` is true in it, s.

    Each of the `times` loads has a browser of its own. program: the browser's path. Raises
    TimeoutError.
    """
    loads_s = []
    for _ in range(times):
        async with _new_page(program) as command:
            await command("Page.enable")
            began_s = time.perf_counter()
            await command("Page.navigate", url=address)
            async with asyncio.timeout(_PATIENCE_S):
                while not await _evaluates_to_true(command, ready):
                    await asyncio.sleep(_LOOK_S)
            loads_s.append(time.perf_counter() - began_s)
    return sorted(loads_s)[len(loads_s) // 2]


async def _evaluates_to_true(command: Any, expression: str) -> bool:
    answer = await command("Runtime.evaluate", expression=expression, returnByValue=True)
    return answer.get("result", {}).get("value") is True


@asynccontextmanager
async def _new_page(program: str) -> AsyncIterator[Any]:
    """Run a browser with an empty cache; yield a function for Chrome DevTools commands."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        no_output = subprocess.DEVNULL
        command = [program, *_FLAGS, f"--user-data-dir={folder}", "about:blank"]
        with started(command, stdout=no_output, stderr=no_output):
            async with asyncio.timeout(_PATIENCE_S):
                url = await _page_url(Path(folder) / "DevToolsActivePort")
            async with connect(url, max_size=None, proxy=None, compression=None) as socket:
                yield _command_sender(socket)


async def _page_url(file: Path) -> str:
    """Return the debugger's URL of the browser's first page.

    file: where the browser writes its port.
    """
    while not file.exists() or len(file.read_text().splitlines()) < 2:
        await asyncio.sleep(_LOOK_S)
    port = file.read_text().splitlines()[0]
    while True:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=10) as answer:
            pages = [each for each in json.load(answer) if each["type"] == "page"]
        if pages:
            return str(pages[0]["webSocketDebuggerUrl"])
        await asyncio.sleep(_LOOK_S)


def _command_sender(socket: ClientConnection) -> Any:
    """Return a coroutine function that sends a DevTools command and returns its result.

    Messages with another number, such as events, are dropped meanwhile.
    """
    message_ids = itertools.count(1)

    async def command(method: str, **parameters: object) -> dict[str, Any]:
        message_id = next(message_ids)
        await socket.send(json.dumps({"id": message_id, "method": method, "params": parameters}))
        while True:
            answer = json.loads(await socket.recv())
            if answer.get("id") == message_id:
                return dict(answer.get("result") or {})

    return command


_SERVED_HEAD_PATIENCE_S: Final = 180.0
_SERVED_HEAD_LOOK_S: Final = 0.2
_SETTLE_S: Final = 3.0


@contextmanager
def served_head() -> Iterator[str]:
    """Run a daemon of `face_head` with a dashboard; yield the address once the dashboard settled.

    Raises TimeoutError where no dashboard answers.
    """
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        host_port = f"127.0.0.1:{probe.getsockname()[1]}"
        probe.close()
        command = [sys.executable, "-P", "-m", "lipservo", "daemon", "--config", "face_head"]
        command += ["--quiet", "--dashboard", "--dashboard-listen", host_port, "--sounds", folder]
        command += ["--open-to-this-computer", "--listen", "127.0.0.1:0"]
        with started([*command, "--control", str(Path(folder) / "head.sock")]):
            _wait_for_url(f"http://{host_port}/api/health")
            _wait_for_url(f"http://{host_port}/twin/head.bin")  # is made while the rest starts
            time.sleep(_SETTLE_S)
            yield f"http://{host_port}"


def _wait_for_url(url: str) -> None:
    """Wait until a URL answers with success; raise TimeoutError after `_SERVED_HEAD_PATIENCE_S`."""
    give_up_s = time.monotonic() + _SERVED_HEAD_PATIENCE_S
    while time.monotonic() < give_up_s:
        try:
            with urllib.request.urlopen(url, timeout=5.0):
                return
        except OSError:
            time.sleep(_SERVED_HEAD_LOOK_S)
    raise TimeoutError(f"no dashboard answers at {url}")


def face_figures(voices: Sequence[Path], seconds: float, advance: Advance) -> dict[str, object]:
    """Return all figures of `bench face`: of the dashboard's streams, expression, and the page.

    voices: sound files of one speaker or several; none: the bundled clip. seconds: for how long the
    streams are measured with each number of clients.
    """
    advance("face", 0, 3)
    figures: dict[str, object] = dict(stream_figures(seconds))
    advance("face", 1, 3)
    figures |= asdict(expression_figures(lambda: LiveExpression(1), heard(voices)))
    advance("face", 2, 3)
    with served_head() as address:
        figures["page_ready_s"] = page_ready_s(address, times=5)
    return figures


def heard(voices: Sequence[Path]) -> list[VoiceFrame]:
    """Return the voice tracker's frames of sound files; without files, of the bundled clip.

    Raises SoundError.
    """
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        frames = []
        tracker = VoiceTracker()
        for path in voices or [clip]:
            with FileSource(path) as source:
                frames += [tracker.feed(block.samples) for block in source.blocks(float("inf"))]
    return frames
