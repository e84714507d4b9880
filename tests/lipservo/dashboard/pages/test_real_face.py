"""A face with simulated servos, as users start it: moved by hand and stopped from a page."""

import re
import subprocess
import sys

import pytest
from places import ROOT, short_folder


@pytest.fixture
def page(chromium, browser, served):
    del chromium
    control = short_folder() / "face.sock"
    command = [sys.executable, "-m", "lipservo", "daemon", "--config", "face_head"]
    options = ["--listen", "none", "--control", str(control)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*command, *options], cwd=ROOT, **quiet) as process:
        try:
            with served(control, "--listen", "127.0.0.1:0") as (address, _):
                made = browser.new_page()
                made.goto(f"{address}/servos")
                made.wait_for_function(
                    "window.dashboard?.status && window.dashboard.frame", timeout=60_000
                )
                yield made
                made.close()
        finally:
            process.terminate()


def encoder(servo):
    return f"dashboard.frame.encodersDeg[dashboard.hello.servos.indexOf('{servo}')]"


def origin(page):
    return re.match(r"https?://[^/]+", page.url)[0]


@pytest.mark.slow
def test_it_is_moved_within_its_limits_and_stopped_to_the_confirmed_end(page):
    page.locator("face-jog .switch").click()
    page.locator("face-jog .switch", has_text="Armed").wait_for()
    beyond = {"action": "move", "servo": "jaw", "deg": 90}
    asked = page.request.post(f"{origin(page)}/api/jog", data=beyond)
    assert asked.status == 422
    assert asked.json()["error"] == "jaw is 90 deg; allowed: -2 to 25 deg"

    jaw = page.locator('.slider[data-servo="jaw"] input')
    jaw.evaluate("(i) => { i.value = 20; i.dispatchEvent(new Event('input')); }")
    page.wait_for_function(f"Math.abs({encoder('jaw')} - 20) < 1")

    page.keyboard.press("Escape")

    page.locator("#face-stop-report", has_text="confirmed by 16 servos").wait_for()
