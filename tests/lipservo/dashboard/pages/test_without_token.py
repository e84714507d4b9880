"""A browser without the token: STOP works, and the address that was printed opens the page."""

import os
import re
import subprocess
import sys

import pytest
from acted_face import ActedFace
from places import short_folder

pytestmark = pytest.mark.slow


@pytest.fixture
def locked(chromium):
    """A face, and the address of its dashboard as it is printed in a terminal."""
    del chromium
    folder = short_folder()
    session = short_folder()
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(session)}
    with ActedFace(folder) as face:
        command = [sys.executable, "-m", "lipservo", "dashboard", "--control", str(face.path)]
        with subprocess.Popen(
            [*command, "--listen", "127.0.0.1:0"],
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        ) as process:
            try:
                for line in process.stderr:
                    if found := re.search(r"dashboard: (http\S+)", line):
                        break
                token = (session / "lipservo" / "token").read_text().strip()
                yield face, f"{found[1]}/?token={token}"
            finally:
                process.terminate()


def test_stop_works_without_the_token_and_the_printed_address_opens_the_page(locked, browser):
    face, printed = locked
    address, _, token = printed.partition("/?token=")
    with browser.new_context() as context:
        page = context.new_page()
        refused = page.goto(address)
        assert refused.status == 401
        page.get_by_text("lipservo dashboard --open").wait_for()
        page.locator("#face-stop[data-ready]").click()
        page.locator("#face-stop-report", has_text="confirmed by 16 servos").wait_for()
        assert face.said[0] == "soft"

        page.goto(printed)
        page.wait_for_function("window.dashboard?.status && window.dashboard.frame")
        assert token not in page.url
        page.goto(f"{address}/servos")
        page.wait_for_function("window.dashboard?.status")
