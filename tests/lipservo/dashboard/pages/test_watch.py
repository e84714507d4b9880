"""That a page never looks well when something is gone, and who may open it."""

import os
import signal
import time

import pytest

BANNER = "#face-banner"
SOON_S = 2.5

#: A minute of a real browser; CI runs it once.
pytestmark = pytest.mark.slow


def banner_after_s(page, text):
    """How long until the banner says so."""
    began_s = time.monotonic()
    page.locator(BANNER, has_text=text).wait_for(timeout=8000)
    return time.monotonic() - began_s


@pytest.fixture
def watched(opened):
    page = opened()
    page.wait_for_timeout(300)
    assert page.locator(BANNER).is_hidden()
    return page


def test_a_side_of_the_face_that_is_gone_has_a_banner(watched, face):
    face.writes_servos = False
    banner_after_s(watched, "The servo side (bridge) does not answer")
    watched.locator("#face-state", has_text="servo side gone").wait_for(timeout=8000)

    face.writes_servos, face.writes_speech = True, False
    banner_after_s(watched, "The speech side does not answer")

    face.writes_speech = True
    watched.locator(BANNER).wait_for(state="hidden")


def test_a_dashboard_that_is_gone_has_a_banner(watched, dashboard):
    os.kill(dashboard[1].pid, signal.SIGSTOP)
    try:
        banner_after_s(watched, "The dashboard does not answer: what you see is old")
        watched.locator("#face-state", has_text="no connection").wait_for(timeout=8000)
    finally:
        os.kill(dashboard[1].pid, signal.SIGCONT)

    watched.locator(BANNER).wait_for(state="hidden", timeout=8000)


def test_the_banner_is_there_at_once(watched, face, dashboard):
    """Within a second where the computer does nothing else (docs/benchmarks.md); this one may."""
    face.writes_servos = False
    assert banner_after_s(watched, "The servo side") <= SOON_S
    face.writes_servos = True
    watched.locator(BANNER).wait_for(state="hidden")

    os.kill(dashboard[1].pid, signal.SIGSTOP)
    try:
        assert banner_after_s(watched, "The dashboard does not answer") <= SOON_S
    finally:
        os.kill(dashboard[1].pid, signal.SIGCONT)


def test_beyond_loopback_a_page_opens_with_the_token_alone(served, browser, face, tmp_path):
    secret = "a token of this test"
    file = tmp_path / "token"
    file.write_text(secret)
    file.chmod(0o600)
    options = ("--listen", "0.0.0.0:0", "--token-file", str(file))
    with served(face.path, *options) as (address, _), browser.new_context() as context:
        local = address.replace("0.0.0.0", "127.0.0.1")
        page = context.new_page()
        assert page.goto(local).status == 401
        assert page.goto(f"{local}/api/status").status == 401

        page.goto(f"{local}/?token={secret}")
        page.wait_for_function("window.dashboard?.frame")
        assert "token" not in page.url
