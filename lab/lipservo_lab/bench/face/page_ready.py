"""How long the page takes until it shows the face, in a browser that draws in software."""

import asyncio
import itertools
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from websockets.asyncio.client import ClientConnection, connect

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
    """The program of a Chromium; None: none is installed."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


def page_ready_s(address: str, times: int = 3, ready: str = READY) -> float | None:
    """From asking for the page until it is ready, the median; None without a Chromium.

    ready: what is true in the page once it is. The browser runs already; nothing is in its cache
    the first time. Raises TimeoutError.
    """
    program = browser()
    if program is None:
        return None
    return asyncio.run(_measured(program, address, times, ready))


async def _measured(program: str, address: str, times: int, ready: str) -> float:
    taken = []
    for _ in range(times):
        async with _new_page(program) as ask:
            await ask("Page.enable")
            began_s = time.perf_counter()
            await ask("Page.navigate", url=address)
            async with asyncio.timeout(_PATIENCE_S):
                while not await _is_true(ask, ready):
                    await asyncio.sleep(_LOOK_S)
            taken.append(time.perf_counter() - began_s)
    return sorted(taken)[len(taken) // 2]


async def _is_true(ask: Any, expression: str) -> bool:
    told = await ask("Runtime.evaluate", expression=expression, returnByValue=True)
    return told.get("result", {}).get("value") is True


@asynccontextmanager
async def _new_page(program: str) -> AsyncIterator[Any]:
    """A browser with nothing in its cache; asks it by the Chrome DevTools Protocol."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        quiet = subprocess.DEVNULL
        command = [program, *_FLAGS, f"--user-data-dir={folder}", "about:blank"]
        with subprocess.Popen(command, stdout=quiet, stderr=quiet) as process:
            try:
                async with asyncio.timeout(_PATIENCE_S):
                    url = await _page_url(Path(folder) / "DevToolsActivePort")
                async with connect(url, max_size=None, proxy=None, compression=None) as socket:
                    yield _asking(socket)
            finally:
                process.terminate()


async def _page_url(file: Path) -> str:
    """Where its first page is asked."""
    import urllib.request

    while not file.exists() or len(file.read_text().splitlines()) < 2:
        await asyncio.sleep(_LOOK_S)
    port = file.read_text().splitlines()[0]
    while True:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=10) as answer:
            pages = [each for each in json.load(answer) if each["type"] == "page"]
        if pages:
            return str(pages[0]["webSocketDebuggerUrl"])
        await asyncio.sleep(_LOOK_S)


def _asking(socket: ClientConnection) -> Any:
    numbers = itertools.count(1)

    async def ask(method: str, **parameters: object) -> dict[str, Any]:
        number = next(numbers)
        await socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            told = json.loads(await socket.recv())
            if told.get("id") == number:
                return dict(told.get("result") or {})

    return ask
