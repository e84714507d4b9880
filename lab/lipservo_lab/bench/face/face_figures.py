"""Everything that `lipservo bench face` prints.

How long the page takes until it shows the face, in a browser that draws in software.

A head that runs with its page, as a user starts it.

What `lipservo bench face` says of the twin's mesh.
"""

import asyncio
import itertools
import json
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np
from websockets.asyncio.client import ClientConnection, connect

from lipservo_lab.bench.face.play_queue import play_figures
from lipservo_lab.bench.face.streams import stream_figures
from lipservo_lab.evaluation.expression.expression_figures import expression_figures
from lipsync.audio.file import FileSource
from lipsync.expression.live_expression import LiveExpression
from lipsync.face.model import FaceModel, load_face
from lipsync.prosody.voice_frame import VoiceFrame
from lipsync.prosody.voice_tracker import VoiceTracker
from lipsync.twin.head_surface import head_surface, load_mean_face
from lipsync.twin.packed import pack, unpack
from lipsync.twin.twin import make_twin, skin_morphs, worn_face

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
    answer = await ask("Runtime.evaluate", expression=expression, returnByValue=True)
    return answer.get("result", {}).get("value") is True


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
    """The debugger's URL of its first page."""
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
            answer = json.loads(await socket.recv())
            if answer.get("id") == number:
                return dict(answer.get("result") or {})

    return ask


_SERVED_HEAD_PATIENCE_S: Final = 180.0
_SERVED_HEAD_LOOK_S: Final = 0.2
_END_S: Final = 30.0
_SETTLE_S: Final = 3.0


@contextmanager
def served_head() -> Iterator[str]:
    """`face_head` with a dashboard that has settled; the address.

    Raises TimeoutError where none comes.
    """
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        listen = f"127.0.0.1:{probe.getsockname()[1]}"
        probe.close()
        command = [
            sys.executable,
            "-P",
            "-m",
            "lipservo",
            "daemon",
            "--config",
            "face_head",
            "--quiet",
        ]
        command += ["--dashboard", "--dashboard-listen", listen]
        command += ["--open-to-this-computer", "--sounds", folder, "--listen", "127.0.0.1:0"]
        with subprocess.Popen([*command, "--control", str(Path(folder) / "head.sock")]) as process:
            try:
                _wait_for(f"http://{listen}/api/health")
                _wait_for(f"http://{listen}/twin/head.bin")  # is made while the rest starts
                time.sleep(_SETTLE_S)
                yield f"http://{listen}"
            finally:
                process.terminate()
                process.wait(_END_S)


def _wait_for(url: str) -> None:
    give_up_s = time.monotonic() + _SERVED_HEAD_PATIENCE_S
    while time.monotonic() < give_up_s:
        try:
            with urllib.request.urlopen(url, timeout=5.0):
                return
        except OSError:
            time.sleep(_SERVED_HEAD_LOOK_S)
    raise TimeoutError(f"no dashboard answers at {url}")


_FACES = 500


@dataclass(frozen=True, slots=True)
class TwinFigures:
    """Measured on this computer.

    triangles: of the skin. deform_precompute_s: from the surface to the targets of all
    components, the best of three. deform_frame_ms: one frame of the skin on the processor, float32,
    the median. marker_error_mm: the greatest distance of a marker's vertex from its marker in 500
    faces as likely as in speech, of what a page gets. least_weight, greatest_weight: of the shell.
    twin_bytes: what a page loads, before gzip. twin_made_s: all that is made at the start, without
    loading libraries.
    """

    triangles: int
    deform_precompute_s: float
    deform_frame_ms: float
    marker_error_mm: float
    least_weight: float
    greatest_weight: float
    twin_bytes: int
    twin_made_s: float


def twin_figures(face: FaceModel, seed: int = 0) -> TwinFigures:
    """All of them; takes a few seconds."""
    mean = load_mean_face()
    precompute_s = []
    for _ in range(3):
        surface = head_surface(mean)
        begun = time.perf_counter()
        skin = skin_morphs(face, surface)
        precompute_s.append(time.perf_counter() - begun)
    begun = time.perf_counter()
    packed = pack(make_twin(face, mean))
    twin_made_s = time.perf_counter() - begun
    random = np.random.default_rng(seed)
    coefficients = random.multivariate_normal(
        np.zeros(face.n_components), face.covariance, _FACES
    ).astype(np.float32)
    drawn = unpack(packed)["skin"]
    base = drawn["places_mm"].ravel()
    targets = np.stack([drawn["morphs"][f"c{k}"].ravel() for k in range(face.n_components)])
    frame_s, misses_mm = [], []
    markers = [face.layout.landmarks[i] for i in skin.points]
    mean_mm, basis = worn_face(face, surface.places_mm[markers], skin.points)
    wanted = mean_mm + np.tensordot(coefficients.astype(np.float64), basis, axes=1)
    for row, wanted_mm in zip(coefficients, wanted, strict=True):
        begun = time.perf_counter()
        mesh = base + row @ targets
        frame_s.append(time.perf_counter() - begun)
        misses_mm.append(np.linalg.norm(mesh.reshape(-1, 3)[markers] - wanted_mm, axis=1).max())
    return TwinFigures(
        triangles=len(surface.triangles),
        deform_precompute_s=min(precompute_s),
        deform_frame_ms=1000.0 * float(np.median(frame_s)),
        marker_error_mm=float(np.max(misses_mm)),
        least_weight=float(skin.weights.min()),
        greatest_weight=float(skin.weights.max()),
        twin_bytes=len(packed),
        twin_made_s=twin_made_s,
    )


Progress = Callable[[str, int, int], None]


def face_figures(voices: Sequence[Path], seconds: float, progress: Progress) -> dict[str, object]:
    """Twin, streams, plays, expression, page. voices: sound files of one speaker or several.

    Without one, the bundled clip speaks. seconds: how long each window of the streams takes.
    """
    figures: dict[str, object] = dict(asdict(twin_figures(load_face())))
    progress("twin", 1, 1)
    figures |= stream_figures(seconds, lambda done, of: progress("streams", done, of))
    figures |= play_figures(seconds)
    progress("plays", 1, 1)
    frames, step_ms = heard(voices)
    figures |= asdict(expression_figures(lambda: LiveExpression(1), frames))
    figures["voice_step_ms"] = step_ms
    progress("expression", 1, 1)
    with served_head() as address:
        figures["page_ready_s"] = page_ready_s(address, times=5)
    progress("page", 1, 1)
    return figures


def heard(voices: Sequence[Path]) -> tuple[list[VoiceFrame], float]:
    """What a tracker says of sound files, one after the other, and its median time for 10 ms, ms.

    Without a file, of the bundled clip. Raises SoundError.
    """
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        frames, elapsed_s = [], []
        tracker = VoiceTracker()
        for path in voices or [clip]:
            with FileSource(path) as source:
                for block in source.blocks(float("inf")):
                    begun_s = time.perf_counter()
                    frames.append(tracker.feed(block.samples))
                    elapsed_s.append(time.perf_counter() - begun_s)
    return frames, 1e3 * statistics.median(elapsed_s)
