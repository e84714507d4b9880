"""Work done on a Dask cluster that may lose workers, and its scheduler, on the way.

What a task gave is handed out as soon as it is done, and only a few tasks a core are handed over at
a time: whatever dies costs those alone, which are handed over again
(docs/decisions/scripted-lines.md).
"""

import logging
import re
import time
from asyncio import CancelledError
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final, TypeVar
from uuid import uuid4

from lipsync.errors import UserError

if TYPE_CHECKING:
    from distributed import Client, Future

_ADDRESS: Final = re.compile(r"((tcp|tls)://)?(\[[0-9a-fA-F:]+\]|[^\s/:\[\]]+):\d{1,5}")
#: A scheduler answers in milliseconds; a computer that sleeps, never.
_CONNECTING_S: Final = 10.0
#: A worker that crashed is started again by its nanny within seconds, a scheduler by its service.
_AWAY_S: Final = 180.0
_LOOK_S: Final = 0.1
_ASK_S: Final = 0.5
_ANSWER_S: Final = 5.0
_CLOSING_S: Final = 2.0
#: One is computed, the next is there when it is done.
_TASKS_A_CORE: Final = 2
#: Dask's own words are for those who run the cluster; ours are one line.
_LOUD: Final = ("distributed", "distributed.client", "tornado.application", "asyncio")

#: What waiting for a cluster raises; a connection that broke and a time that is over are OSErrors.
_LOST: Final = (OSError, CancelledError, futures.CancelledError)

Task = TypeVar("Task")
Result = TypeVar("Result")


class ClusterError(UserError):
    """A cluster that cannot be used, or fails; one line."""


@contextmanager
def cluster_at(address: str) -> Iterator["Cluster"]:
    """Yield a connection to the scheduler at HOST:PORT. Raises ClusterError."""
    if not _ADDRESS.fullmatch(address):
        raise ClusterError(f"--dask {address}: write HOST:PORT, as `dask scheduler` prints it")
    import distributed  # noqa: F401 (which sets the levels of its loggers)

    for name in _LOUD:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        cluster = Cluster(address)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"--dask {address}: no Dask scheduler answers there ({_one_line(error)}); start one "
            "with `dask scheduler`, and `dask worker` on every computer"
        ) from error
    try:
        yield cluster
    finally:
        cluster.close()


class Cluster:
    """The Dask cluster of a scheduler; where that is lost, the one that comes in its place."""

    def __init__(self, address: str) -> None:
        """Connect. Raises OSError, ValueError."""
        self._address = address
        self._client = self._connected()
        self._n_cores = 0
        self._counted_s = float("-inf")
        self._seen_s = time.monotonic()

    def close(self) -> None:
        """End the connection; what is still computed is given up."""
        with suppress(Exception):  # the scheduler may be gone already
            self._client.close(timeout=_CLOSING_S)

    def done(
        self, work: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result | ClusterError]]:
        """Yield the number of each task with what `work` makes of it, as it is done.

        A ClusterError in its place: workers died with this task again and again. Raises
        ClusterError where no worker or scheduler is there for three minutes; whatever `work` raises
        is raised here.
        """
        waiting = deque(range(len(tasks)))
        handed: dict[Future, int] = {}
        ended: SimpleQueue[Future] = SimpleQueue()
        while waiting or handed:
            n_wanted = _TASKS_A_CORE * self._cores() - len(handed)
            for _ in range(min(n_wanted, len(waiting))):
                try:
                    key = f"lipservo-{waiting[0]}-{uuid4()}"
                    future = self._client.submit(work, tasks[waiting[0]], key=key)
                except Exception:  # of any kind, where the scheduler has just ended
                    break
                handed[future] = waiting.popleft()
                future.add_done_callback(ended.put)
            try:
                future = ended.get(timeout=_LOOK_S)
            except Empty:
                continue
            outcome = _outcome(future)
            n = handed.pop(future)
            if outcome is None:
                waiting.appendleft(n)
            else:
                yield n, outcome[0]

    def _cores(self) -> int:
        """Return how many cores the workers have; 0, for three minutes at most: none is there."""
        now_s = time.monotonic()
        if now_s - self._counted_s > _ASK_S:
            self._n_cores, self._counted_s = self._count_cores(), now_s
            if self._n_cores:
                self._seen_s = now_s
            elif now_s - self._seen_s > _AWAY_S:
                raise ClusterError(
                    f"the Dask cluster has had no worker for {_AWAY_S:.0f} s, or its scheduler has "
                    "ended; what was rendered before is kept, and the same command goes on from it"
                )
        return self._n_cores

    def _count_cores(self) -> int:
        """Return how many cores the cluster has now; 0 while its scheduler cannot be reached.

        Connects anew where the connection has been given up; may block for `_ANSWER_S`.
        """
        try:
            if self._client.status == "closed":  # it has tried to connect again for long enough
                self._client = self._connected()
            found = self._client.sync(self._client.scheduler.ncores, callback_timeout=_ANSWER_S)
        except Exception:  # of any kind, while the scheduler is away
            return 0
        return sum(found.values())

    def _connected(self) -> "Client":
        from distributed import Client

        return Client(self._address, timeout=_CONNECTING_S, set_as_default=False, name="lipservo")


def _outcome(future: "Future") -> tuple[Any] | None:
    """Return what a task gave, or the ClusterError of one that was given up; None: it is lost."""
    from distributed import KilledWorker

    try:
        return (future.result(timeout=_AWAY_S),)
    except KilledWorker as error:
        return (ClusterError(f"the Dask workers failed: {_one_line(error)}"),)
    except _LOST:
        if future.status == "error":
            raise  # it is the work's own
        return None


def _one_line(error: object) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]
