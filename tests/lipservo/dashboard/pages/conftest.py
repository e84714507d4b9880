"""A browser, a face that a test sets, and a dashboard between them: one of each for all tests."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from acted_face import ActedFace
from places import short_folder

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
#: Headless, drawn by the processor, and asking nobody anything of its own.
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--no-first-run", "--disable-quic",
)  # fmt: skip
_NO_CHROMIUM = "no chromium on this computer: apt install chromium"
#: What a browser says by itself when a request fails that a test has made fail.
_OF_FAILED_REQUESTS = "Failed to load resource"


@contextmanager
def _served(control, *options):
    """A dashboard of the face at a socket, in a process of its own: (address, process)."""
    command = [sys.executable, "-m", "lipservo", "dashboard", "--control", str(control), *options]
    if "--token-file" not in options:
        command += ["--open-to-this-computer"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            for line in process.stderr:
                if found := re.search(r"dashboard: (http\S+)", line):
                    break
            else:
                pytest.fail("the dashboard did not start")
            yield found[1].split("/?token=")[0], process
        finally:
            process.terminate()


@pytest.fixture(scope="session")
def served():
    """Start another dashboard: `served(control socket, *options)`."""
    return _served


@pytest.fixture(scope="module")
def chromium():
    """Start one with other flags than the shared one.

    Of a module, not of a session: while Playwright runs, nothing else may run an event loop.
    """
    if CHROMIUM is None:
        pytest.skip(_NO_CHROMIUM)
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        yield lambda *more: driver.chromium.launch(executable_path=CHROMIUM, args=[*FLAGS, *more])


@pytest.fixture(scope="module")
def browser(chromium):
    started = chromium()
    yield started
    started.close()


@pytest.fixture(scope="session")
def sounds(tmp_path_factory):
    return tmp_path_factory.mktemp("sounds")


@pytest.fixture(scope="session")
def shared_face(sounds):
    if CHROMIUM is None:
        pytest.skip(_NO_CHROMIUM)
    with ActedFace(short_folder(), sounds=sounds) as face:
        yield face


@pytest.fixture(scope="session")
def dashboard(shared_face) -> Iterator[tuple[str, subprocess.Popen]]:
    with _served(shared_face.path, "--listen", "127.0.0.1:0") as started:
        yield started


@pytest.fixture
def face(shared_face):
    shared_face.rest()
    yield shared_face
    shared_face.rest()


@pytest.fixture
def address(dashboard):
    return dashboard[0]


@pytest.fixture(scope="module")
def context(browser):
    """With one cache for all tests, as one person's browser has."""
    with browser.new_context(viewport={"width": 1280, "height": 800}) as made:
        yield made


@pytest.fixture(scope="module")
def module_page(context, dashboard):
    """One page of a dashboard, whose modules a test imports: for what is pure in them."""
    page = context.new_page()
    page.goto(f"{dashboard[0]}/calibrate")
    yield page
    page.close()


@pytest.fixture
def startable(context, face):
    """`POST /api/start` of every page reaches the acted face; the server's own is not needed."""

    def answer(route):
        answered = face.start()
        route.fulfill(status=422 if "error" in answered else 200, json=answered)

    context.route("**/api/start", answer)
    yield face
    context.unroute("**/api/start", answer)


@pytest.fixture
def opened(context, address, face, tmp_path, request):
    """Opens pages: `opened("/servos")`; ready when the first frame of the face has come.

    After the test: no page has said an error, or asked anybody but its dashboard. A screenshot of
    each lies in the folder LIPSERVO_SCREENSHOTS, or in the test's own.
    """
    del face
    folder = Path(os.environ.get("LIPSERVO_SCREENSHOTS", tmp_path))
    errors, strangers = [], []

    def failed(error):
        errors.append(str(error.error))

    def heard(message):
        if message.type == "error" and _OF_FAILED_REQUESTS not in message.text:
            errors.append(message.text)

    def asked(outgoing):
        own = (address, address.replace("http", "ws", 1), "data:", "blob:")
        if not outgoing.url.startswith(own):
            strangers.append(outgoing.url)

    listeners = {"console": heard, "request": asked, "weberror": failed}
    for kind, listener in listeners.items():
        context.on(kind, listener)

    def open_page(path="/"):
        page = context.new_page()
        page.goto(address + path)
        page.wait_for_function("window.dashboard?.frame && document.querySelector('.face-page')")
        return page

    yield open_page
    folder.mkdir(parents=True, exist_ok=True)
    for n, page in enumerate(context.pages):
        name = re.sub(r"\W+", "-", request.node.name).strip("-")
        page.screenshot(path=folder / f"{name}-{n}.png")
        page.close()
    for kind, listener in listeners.items():
        context.remove_listener(kind, listener)
    assert errors == []
    assert strangers == []
