"""The twin in a real browser, headless and drawn in software; numbers, not pixels."""

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import pytest
from places import ROOT

from lipsync.face.model import load_face
from lipsync.twin.head_surface import head_surface, load_mean_face
from lipsync.twin.twin import skin_morphs

sync_api = pytest.importorskip("playwright.sync_api")
CHROMIUM = shutil.which("chromium")
FACE = load_face()
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--no-first-run",
]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium"),
]


@pytest.fixture(scope="module")
def address():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    page = Path(__file__).with_name("twin_page.py")
    # NiceGUI behaves otherwise where it finds itself in a test.
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    server = subprocess.Popen([sys.executable, page, str(port)], cwd=ROOT, env=environment)
    found = f"http://127.0.0.1:{port}"
    try:
        for _ in range(600):
            assert server.poll() is None
            try:
                urlopen(f"{found}/twin/head.bin", timeout=30).close()
                break
            except URLError:
                time.sleep(0.1)
        yield found
    finally:
        server.terminate()
        server.wait(10)


@pytest.fixture(scope="module")
def browse(address):
    """A page with the twin, ready, in a browser of its own; and every address it asked for."""
    with sync_api.sync_playwright() as playwright:
        browsers = []

        def open_page(*flags):
            browser = playwright.chromium.launch(
                executable_path=CHROMIUM, args=[*FLAGS, *flags], timeout=60_000
            )
            browsers.append(browser)
            page = browser.new_page(viewport={"width": 340, "height": 340})
            asked = []
            page.on("request", lambda request: asked.append(request.url))
            page.goto(address, timeout=60_000)
            page.wait_for_function("window.twin?.ready", timeout=60_000)
            return page, asked

        yield open_page
        for each in browsers:
            each.close()


@pytest.fixture(scope="module")
def opened(browse):
    return browse()


def frame(coefficients=FACE.rest, **expression):
    return {"coefficients": [float(each) for each in coefficients], "expression": expression}


def shown(page, given):
    page.evaluate("frame => twin.apply(frame)", given)
    return page.evaluate("({...twin.pose, gapMm: twin.gapMm})")


@pytest.mark.slow
def test_the_head_is_drawn_and_nothing_is_asked_of_anybody_else(opened, address):
    page, asked = opened

    assert page.evaluate("[twin.kind, twin.triangles]") == [
        "webgl",
        29_184 // 4,
    ]  # drawn by the processor
    assert [url for url in asked if not url.startswith((address, "data:", "blob:"))] == []


def test_lips_open_in_the_browser_as_far_as_the_solver_says(opened):
    page, _ = opened
    skin = skin_morphs(FACE, head_surface(load_mean_face()))
    random = np.random.default_rng(0)
    for coefficients in random.multivariate_normal(FACE.rest, FACE.covariance, 5):
        mesh = skin.places_mm + np.tensordot(coefficients, skin.targets_mm, axes=1)

        gap_mm = shown(page, frame(coefficients))["gapMm"]

        assert gap_mm == pytest.approx(mesh[13, 1] - mesh[14, 1], abs=0.005)


def test_a_frame_turns_head_and_eyes_and_moves_lids_brows_and_smile(opened):
    page, _ = opened

    pose = shown(
        page,
        frame(
            neck_yaw_deg=12.0,
            neck_pitch_deg=-4.0,
            eye_yaw_deg=-9.0,
            lid_left=0.5,
            lid_right=1.0,
            brow=0.4,
            smile=-0.2,
        ),
    )

    assert pose["neckDeg"] == {"pitch": -4.0, "yaw": 12.0, "roll": 0}
    assert pose["eyesDeg"] == {"pitch": 0, "yaw": -9.0, "roll": 0}
    targets = pose["targets"]
    assert (targets["lid_left"], targets["lid_left_over"]) == (0.5, 0.25)
    assert (targets["lid_right"], targets["lid_right_over"]) == (1.0, 0.0)
    assert (targets["brow"], targets["smile"]) == (0.4, -0.2)


def test_what_a_frame_leaves_open_rests(opened):
    page, _ = opened

    pose = shown(page, {"coefficients": [], "expression": {"brow": None, "lid_left": 7.0}})

    rest = [pose["targets"][f"c{k}"] for k in range(FACE.n_components)]
    np.testing.assert_allclose(rest, FACE.rest)
    assert pose["targets"]["brow"] == 0
    assert pose["targets"]["lid_left"] == 1


def test_frames_are_counted_and_only_the_newest_is_drawn(opened):
    page, _ = opened
    before = page.evaluate("[twin.frames, twin.drawn]")

    page.evaluate(
        """rest => { for (let n = 1; n <= 50; n += 1)
          twin.apply({n, coefficients: rest, expression: {brow: n / 100}}); }""",
        FACE.rest.tolist(),
    )
    page.wait_for_function("drawn => twin.drawn > drawn", arg=before[1], timeout=30_000)

    after = page.evaluate("[twin.frames, twin.drawn, twin.last.n, twin.pose.targets.brow]")
    assert after[0] == before[0] + 50
    assert after[1] - before[1] <= 3
    assert after[2:] == [50, 0.5]


def test_a_frame_that_changes_nothing_is_not_drawn_again(opened):
    page, _ = opened
    still = frame(smile=0.3)
    shown(page, still)
    settled = "new Promise(done => setTimeout(() => done(twin.drawn), 600))"
    drawn = page.evaluate(settled)

    shown(page, still)

    assert page.evaluate(settled) == drawn


def test_without_webgl_a_simple_drawing_says_so(browse):
    page, _ = browse("--disable-3d-apis")

    assert page.evaluate("twin.kind") == "canvas"
    assert page.get_by_text("WebGL is not available: simple drawing").is_visible()
    drawn = page.evaluate("twin.drawn")
    shown(page, frame(0 * FACE.rest, lid_left=1.0))
    page.wait_for_function("drawn => twin.drawn > drawn", arg=drawn, timeout=30_000)
