"""Work on a real Dask cluster of two worker processes on this machine."""

import os
import signal
import time

import numpy as np
import pytest
from lipservo_lab.rendering import cluster
from lipservo_lab.rendering.cluster import ClusterError, cluster_at, done_on_cluster

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


def test_results_come_in_order_and_each_is_told(two_workers, monkeypatch):
    monkeypatch.setattr(cluster, "_TASKS_A_CORE", 3)
    told = []
    with cluster_at(two_workers.scheduler_address) as client:
        found = list(done_on_cluster(client, np.square, range(20), lambda: told.append(1)))

    assert found == [n * n for n in range(20)]
    assert len(told) == 20


def test_what_the_work_raises_is_raised(two_workers):
    with (
        cluster_at(two_workers.scheduler_address) as client,
        pytest.raises(ValueError, match="invalid literal"),
    ):
        list(done_on_cluster(client, int, ["1", "x"], lambda: None))


def test_a_worker_that_dies_is_made_up_for_by_the_other(two_workers):
    with cluster_at(two_workers.scheduler_address) as client:
        pid = next(iter(client.run(os.getpid).values()))
        told = []

        def advance():
            if not told:
                os.kill(pid, signal.SIGKILL)
            told.append(1)

        found = list(done_on_cluster(client, time.sleep, [0.2] * 8, advance))

    assert found == [None] * 8
    assert len(told) == 8


def test_a_task_whose_workers_die_again_and_again_is_one_line():
    with (
        distributed.LocalCluster(n_workers=2, host="127.0.0.1", dashboard_address=None) as made,
        cluster_at(made.scheduler_address) as client,
        pytest.raises(ClusterError, match=r"workers failed: KilledWorker|no worker") as raised,
    ):
        list(done_on_cluster(client, os._exit, [1], lambda: None))
    assert "\n" not in str(raised.value)


def test_a_cluster_without_workers_is_one_line(monkeypatch):
    monkeypatch.setattr(cluster, "_WITHOUT_WORKERS_S", 2.0)
    with (
        distributed.LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=None) as made,
        cluster_at(made.scheduler_address) as client,
        pytest.raises(ClusterError, match="no worker"),
    ):
        list(done_on_cluster(client, abs, [-1], lambda: None))


@pytest.mark.parametrize("address", ["nowhere", "ftp://x:1", "127.0.0.1:", ""])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(ClusterError, match="is no HOST:PORT"), cluster_at(address):
        pass


def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECTING_S", 1.0)
    with (
        pytest.raises(ClusterError, match="no Dask scheduler answers there") as raised,
        cluster_at("127.0.0.1:9"),
    ):
        pass
    assert "\n" not in str(raised.value)
