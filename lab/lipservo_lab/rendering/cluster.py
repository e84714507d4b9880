"""Work done on a Dask cluster, by joblib's own backend for it (docs/decisions/0030-cluster.md).

That backend waits without end for a task whose workers have died, and for workers that are gone.
So it works in a thread of its own, and the caller looks on.
"""

import logging
import re
import threading
import time
from asyncio import CancelledError
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final, Generic, TypeVar

import joblib

from lipsync.errors import UserError

if TYPE_CHECKING:
    from distributed import Client

_ADDRESS: Final = re.compile(r"((tcp|tls)://)?(\[[0-9a-fA-F:]+\]|[^\s/:\[\]]+):\d{1,5}")
#: A scheduler answers in milliseconds; a computer that sleeps, never.
_CONNECTING_S: Final = 10.0
#: A worker that crashed is started again by its nanny within seconds.
_WITHOUT_WORKERS_S: Final = 30.0
_LOOK_S: Final = 0.1
_ASK_S: Final = 0.5
_CLOSING_S: Final = 2.0
#: Results are taken in parts of so many a core: what is done is kept, whatever becomes of the rest.
_TASKS_A_CORE: Final = 16
#: Dask's own words are for those who run the cluster; ours are one line.
_LOUD: Final = ("distributed", "distributed.client", "tornado.application", "asyncio")

#: What waiting for a cluster raises; a connection that broke and a time that is over are OSErrors.
_LOST: Final = (OSError, CancelledError, futures.CancelledError)

Task = TypeVar("Task")
Result = TypeVar("Result")


class ClusterError(UserError):
    """A cluster that cannot be used, or fails; one line."""


@contextmanager
def cluster_at(address: str) -> Iterator["Client"]:
    """A connection to the scheduler at HOST:PORT. Raises ClusterError."""
    if not _ADDRESS.fullmatch(address):
        raise ClusterError(f"--dask {address}: is no HOST:PORT, as `dask scheduler` prints it")
    from distributed import Client

    for name in _LOUD:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        client = Client(address, timeout=_CONNECTING_S, set_as_default=False, name="lipservo")
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(
            f"--dask {address}: no Dask scheduler answers there ({_one_line(error)}); start one "
            "with `dask scheduler`, and `dask worker` on every computer"
        ) from error
    try:
        yield client
    finally:
        with suppress(Exception):  # it may be gone already
            client.close(timeout=_CLOSING_S)


def done_on_cluster(
    client: "Client",
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    advance: Callable[[], None],
) -> Iterator[Result]:
    """What `work` makes of each task, in order. advance: called as each is done, in any order.

    Raises ClusterError where workers die with a task again and again, or none is there; whatever
    `work` raises is raised here.
    """
    watch = _Workers(client)
    n_part = _TASKS_A_CORE * max(1, watch.n_cores)
    for first in range(0, len(tasks), n_part):
        parallel = _Parallel(client, work, tasks[first : first + n_part], advance)
        while not parallel.is_done(_LOOK_S):
            watch.check()
            if (reason := _failure(client)) is not None:
                raise ClusterError(f"the Dask workers failed: {reason}")
        try:
            results = parallel.results()
        except (Exception, CancelledError) as error:
            # What a client raises whose scheduler has just ended is of any kind.
            if client.status == "running" and not isinstance(error, _LOST):
                raise
            raise ClusterError(
                f"the Dask scheduler has ended, or has no worker ({_one_line(error)}); what was "
                "rendered before is kept"
            ) from error
        yield from results


class _Parallel(threading.Thread, Generic[Task, Result]):
    """One call of joblib, in a thread that is left to itself where it never ends."""

    def __init__(
        self,
        client: "Client",
        work: Callable[[Task], Result],
        tasks: Sequence[Task],
        advance: Callable[[], None],
    ) -> None:
        super().__init__(name="cluster", daemon=True)
        self._client, self._work, self._tasks, self._advance = client, work, tasks, advance
        self._results: list[Result] = []
        self._error: BaseException | None = None
        self.start()

    def is_done(self, wait_s: float) -> bool:
        """Whether it is, at most so much later."""
        self.join(wait_s)
        return not self.is_alive()

    def results(self) -> list[Result]:
        """In order, once it is done; raises what the work raised."""
        if self._error is not None:
            raise self._error
        return self._results

    def run(self) -> None:
        """Joblib tells no progress but by what it prints."""
        advance, n_reported = self._advance, 0

        class Telling(joblib.Parallel):  # type: ignore[misc]
            def print_progress(self) -> None:
                nonlocal n_reported
                while n_reported < self.n_completed_tasks:
                    n_reported += 1
                    advance()

        try:
            patience = {"wait_for_workers_timeout": _WITHOUT_WORKERS_S}
            with joblib.parallel_config(backend="dask", client=self._client, **patience):
                self._results = Telling()(joblib.delayed(self._work)(task) for task in self._tasks)
        except BaseException as error:
            self._error = error


class _Workers(threading.Thread):
    """Asks the scheduler for its workers, as one that hangs would not answer."""

    def __init__(self, client: "Client") -> None:
        super().__init__(name="cluster workers", daemon=True)
        self._client = client
        self._seen_s = time.monotonic()
        self.n_cores = 1
        with suppress(Exception):  # told by what is asked next
            self.n_cores = sum(client.nthreads().values())
        self.start()

    def run(self) -> None:
        """Until the connection is closed."""
        with suppress(Exception):
            while self._client.status in ("running", "connecting"):
                if self._client.nthreads():
                    self._seen_s = time.monotonic()
                time.sleep(_ASK_S)

    def check(self) -> None:
        """Raises ClusterError where none was seen for long."""
        if time.monotonic() - self._seen_s > _WITHOUT_WORKERS_S:
            raise ClusterError(
                f"the Dask cluster has had no worker for {_WITHOUT_WORKERS_S:.0f} s, or its "
                "scheduler has ended; what was rendered before is kept"
            )


def _failure(client: "Client") -> str | None:
    """Why a task was given up, which joblib does not report."""
    for future in list(client.futures.values()):
        if future.status == "error":
            return _one_line(future.exception)
    return None


def _one_line(error: object) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]
