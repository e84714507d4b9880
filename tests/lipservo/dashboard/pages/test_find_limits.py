"""The page Servos of hobby servos, as `lipservo jog --dashboard` shows it: limits found by hand."""

import os
import re
import subprocess
import sys

import pytest
from places import ROOT, short_folder

from lipservo.settings.settings import load_face

#: A minute of a real browser; CI runs it once.
pytestmark = pytest.mark.slow
JAW = '.slider[data-servo="jaw"]'


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "mine.yaml"
    command = [sys.executable, "-m", "lipservo", "new-face", "-o", str(path)]
    wired = ["--bus", "maestro", "--channel", "jaw=0:opens", "--yes"]
    subprocess.run([*command, *wired], check=True, cwd=ROOT)
    return path


@pytest.fixture
def page(browser, config):
    command = [sys.executable, "-m", "lipservo", "jog", "--dashboard", "--config", str(config)]
    runtime = short_folder()
    environment = {**os.environ, "LIPSERVO_RUNTIME": str(runtime)}
    with subprocess.Popen(
        command, cwd=ROOT, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            address = next(
                found[1]
                for line in process.stderr
                if (found := re.search(r"dashboard: (http\S+)", line))
            )
            made = browser.new_page()
            token = (runtime / "token").read_text().strip()
            made.goto(f"{address}/servos?token={token}", timeout=120_000)
            made.wait_for_function(
                "window.dashboard?.status && window.dashboard.frame", timeout=60_000
            )
            yield made
            made.close()
        finally:
            process.terminate()
            process.communicate(timeout=30)


def arrived(page, pulse_us):
    page.wait_for_function(
        "us => document.querySelector('.slider output').textContent.startsWith(us)", arg=pulse_us
    )


def slide(page, pulse_us):
    """Moves the slider once the page is armed, which it is when the face has answered."""
    page.wait_for_function("document.querySelector('face-jog .switch').ariaChecked === 'true'")
    page.locator(f"{JAW} input").evaluate(
        "(i, us) => { i.value = us; i.dispatchEvent(new Event('input')); }", pulse_us
    )
    arrived(page, str(pulse_us))


def test_a_limit_is_found_a_little_beyond_the_one_that_was_and_written(page, config):
    page.locator("face-jog .switch").click()
    slide(page, 1600)

    page.locator(f"{JAW} .more").click()
    warning = page.locator("face-jog .beyond")
    assert "strips gears" in warning.inner_text()
    assert page.locator(f"{JAW} output").inner_text().startswith("1600")
    warning.locator(".go").click()
    slide(page, 1600)
    page.locator(f"{JAW} .more").click()
    arrived(page, "1610")
    page.locator(f"{JAW} [data-limit=max]").click()

    page.locator("face-jog .said", has_text="max is 1610 µs in the YAML").wait_for()
    assert load_face(config).servos["jaw"].max_us == 1610.0
    page.evaluate("document.querySelector('face-jog').build(['jaw'])")  # as the socket comes back
    assert "max 1610 µs" in page.inner_text(f"{JAW} .saved")
    arrived(page, "1500")  # nobody touched it for 3 s: back to what is wanted of it


def test_nothing_moves_and_nothing_is_set_before_the_switch_is_armed(page, config):
    before = config.read_text()

    assert page.evaluate("document.querySelector('face-jog .sliders').inert") is True
    page.locator(f"{JAW} .more").dispatch_event("pointerdown")
    page.wait_for_timeout(400)

    assert page.locator(f"{JAW} output").inner_text().startswith("1500")
    assert config.read_text() == before


@pytest.fixture
def pressed(page):
    """The moves that are asked for from now on, with the pointer at `+ 10 µs` of an armed page."""
    page.locator("face-jog .switch").click()
    slide(page, 1520)
    page.wait_for_timeout(500)
    moves = []
    page.on("request", lambda asked: '"move"' in (asked.post_data or "") and moves.append(asked))
    page.locator(f"{JAW} .more").hover()
    return moves


def test_a_press_of_the_right_button_moves_nothing(page, pressed):
    page.mouse.down(button="right")
    page.wait_for_timeout(600)

    assert pressed == []


def test_a_button_that_is_held_while_its_row_is_drawn_anew_moves_nothing_more(page, pressed):
    page.mouse.down()
    page.wait_for_timeout(600)
    assert pressed
    page.evaluate("document.querySelector('face-jog').build(['jaw'])")
    page.wait_for_timeout(300)
    pressed.clear()
    page.wait_for_timeout(800)

    assert pressed == []
