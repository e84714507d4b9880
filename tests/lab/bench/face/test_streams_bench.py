"""The measurements of `lipservo bench face` that concern the dashboard."""

import time
from pathlib import Path

import pytest
from lipservo_lab.bench.face.face_figures import browser, page_ready_s
from lipservo_lab.bench.face.streams import clients
from lipservo_lab.seen_processes import processor_s
from served_dashboard import served


@pytest.mark.slow
@pytest.mark.parametrize("path", ["/api/twin", "/api/state"])
def test_what_one_of_several_clients_is_sent_a_second(path):
    """About thirty messages of a hundred bytes, whatever the computer does besides."""
    with served() as dashboard:
        with clients(dashboard.address, 2, path) as received:
            time.sleep(1.0)
        assert 500.0 < received() < 8000.0


def test_processor_time_is_what_the_kernel_says():
    pid = int(Path("/proc/self").readlink().name)
    end_s = time.process_time() + 0.1
    before_s = processor_s(pid)
    while time.process_time() < end_s:
        pass
    assert processor_s(pid) - before_s == pytest.approx(0.1, abs=0.05)


@pytest.mark.skipif(browser() is None, reason="no chromium")
def test_a_page_is_ready_when_it_says_so():
    with served() as dashboard:
        text = "document.body && document.body.innerText.includes('/api/stop')"
        assert page_ready_s(f"{dashboard.address}/docs", 1, text) > 0.0
