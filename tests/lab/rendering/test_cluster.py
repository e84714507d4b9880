"""Work on a real Dask cluster of two worker processes on this machine."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from lipservo_lab.rendering import cluster
from lipservo_lab.rendering.cluster import ClusterError, cluster_at

dask = pytest.importorskip("dask", reason="pip install 'lipservo-lab[cluster]'")
distributed = pytest.importorskip("distributed", reason="pip install 'lipservo-lab[cluster]'")

# Processes that are started, shot and started again.
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("default"),  # what its event loops leave is not ours
]


@pytest.fixture(scope="module")
def two_workers():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as made:
        yield made


def test_each_result_comes_with_the_number_of_its_task(two_workers):
    with cluster_at(two_workers.scheduler_address) as made:
        found = list(made.done(np.square, range(20)))

    assert sorted(found) == [(n, n * n) for n in range(20)]


def test_what_the_work_raises_is_raised(two_workers):
    with (
        cluster_at(two_workers.scheduler_address) as made,
        pytest.raises(ValueError, match="invalid literal"),
    ):
        list(made.done(int, ["1", "x"]))


def test_a_worker_that_dies_is_made_up_for_by_the_other(two_workers):
    with (
        cluster_at(two_workers.scheduler_address) as made,
        distributed.Client(two_workers.scheduler_address, set_as_default=False) as client,
    ):
        pid = next(iter(client.run(os.getpid).values()))
        found = []
        for n, _ in made.done(time.sleep, [0.2] * 8):
            if not found:
                os.kill(pid, signal.SIGKILL)
            found.append(n)

    assert sorted(found) == list(range(8))


def killing(n):
    """Task 1 ends the process that tries it."""
    if n == 1:
        os._exit(1)
    return n


def test_a_task_that_kills_its_workers_is_told_in_one_line(monkeypatch):
    """Dask gives it up, or has no worker left: which of both comes first is Dask's."""
    monkeypatch.setattr(cluster, "_AWAY_S", 10.0)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=2, host="127.0.0.1", dashboard_address=None) as local,
        cluster_at(local.scheduler_address) as made,
    ):
        try:
            told = str(dict(made.done(killing, range(8)))[1])
        except ClusterError as error:
            told = str(error)

    assert "workers failed: KilledWorker" in told or "no worker" in told
    assert "\n" not in told


def test_a_cluster_without_workers_is_one_line(monkeypatch):
    monkeypatch.setattr(cluster, "_AWAY_S", 2.0)
    with (
        distributed.LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=None) as local,
        cluster_at(local.scheduler_address) as made,
        pytest.raises(ClusterError, match="no worker"),
    ):
        list(made.done(abs, [-1]))


@contextlib.contextmanager
def started(*arguments):
    """One of Dask's own programs, as a person starts it; killed at the end."""
    with subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


@contextlib.contextmanager
def whole_cluster(port):
    """A scheduler and a worker, on this port; yields the scheduler."""
    at = ["--host", "127.0.0.1", "--no-dashboard"]
    with (
        started("scheduler", *at, "--port", str(port)) as scheduler,
        started("worker", f"127.0.0.1:{port}", "--nthreads", "1", "--no-dashboard"),
    ):
        yield scheduler


@pytest.mark.parametrize("away_s", [0.0, 12.0], ids=["at once", "later than Dask itself waits"])
def test_a_scheduler_that_dies_is_waited_for_and_nothing_is_lost_or_done_twice(monkeypatch, away_s):
    monkeypatch.setattr(cluster, "_CONNECTING_S", 60.0 if away_s == 0.0 else 5.0)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    found = []
    with contextlib.ExitStack() as stack:
        scheduler = stack.enter_context(whole_cluster(port))
        made = stack.enter_context(cluster_at(f"127.0.0.1:{port}"))
        for n, _ in made.done(time.sleep, [0.3] * 12):
            found.append(n)
            if len(found) == 4:
                scheduler.kill()
                scheduler.wait()
                time.sleep(away_s)
                stack.enter_context(whole_cluster(port))

    assert sorted(found) == list(range(12))


@pytest.mark.parametrize("address", ["nowhere", "ftp://x:1", "127.0.0.1:", ""])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(ClusterError, match="write HOST:PORT"), cluster_at(address):
        pass


def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECTING_S", 1.0)
    with (
        pytest.raises(ClusterError, match="no Dask scheduler answers there") as raised,
        cluster_at("127.0.0.1:9"),
    ):
        pass
    assert "\n" not in str(raised.value)
