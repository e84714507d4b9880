"""The measurements of `lipservo bench face` that concern the dashboard."""

import os
import time
from pathlib import Path

import pytest
from lipservo_lab.bench.face.face_figures import browser, page_ready_s
from lipservo_lab.bench.face.streams import clients
from lipservo_lab.seen_processes import child_of, processor_s
from served_dashboard import served


@pytest.mark.slow
def test_clients_read_a_stream_until_their_block_ends():
    module = "lipservo_lab.bench.face.stream_clients"
    with served() as dashboard:
        with clients(dashboard.address, 2, "/api/twin"):
            assert child_of(os.getpid(), module) is not None
        assert child_of(os.getpid(), module) is None


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
