"""Work on a Dask cluster that may lose workers, and its scheduler, on the way.

Results are yielded as soon as they are there, and only a few tasks a core are submitted at a time:
so only these are lost with a worker or scheduler, and are submitted again
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
#: A scheduler answers in milliseconds; a sleeping computer never does.
_CONNECTING_S: Final = 10.0
#: A crashed worker is started again by its nanny within seconds, a scheduler by its service
#: manager.
_AWAY_S: Final = 180.0
_LOOK_S: Final = 0.1
_ASK_S: Final = 0.5
_ANSWER_S: Final = 5.0
_CLOSING_S: Final = 2.0
#: One is computed, the next one waits at the worker.
_TASKS_A_CORE: Final = 2
#: Loggers of Dask that are silenced; this module's errors are one line.
_LOUD: Final = ("distributed", "distributed.client", "tornado.application", "asyncio")

#: Exceptions of waiting for a lost cluster; broken connections and timeouts are OSErrors.
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
    """The Dask cluster of a scheduler; if the scheduler is lost, of the one that replaces it."""

    def __init__(self, address: str) -> None:
        """Connect to the scheduler at HOST:PORT. Raises OSError, ValueError."""
        self._address = address
        self._client = self._connect()
        self._n_cores = 0
        self._counted_s = float("-inf")
        self._seen_s = time.monotonic()

    def close(self) -> None:
        """End the connection; tasks still computed are given up."""
        with suppress(Exception):  # the scheduler may be gone already
            self._client.close(timeout=_CLOSING_S)

    def done(
        self, work: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result | ClusterError]]:
        """Yield the number of each task with what `work` returns for it, as it is done.

        A ClusterError in place of the result means that workers died with this task again and
        again. Raises ClusterError if no worker or scheduler is there for three minutes, and
        whatever `work` raises.
        """
        waiting = deque(range(len(tasks)))
        submitted: dict[Future, int] = {}
        ended: SimpleQueue[Future] = SimpleQueue()
        while waiting or submitted:
            n_free = _TASKS_A_CORE * self._cores() - len(submitted)
            for _ in range(min(n_free, len(waiting))):
                try:
                    key = f"lipservo-{waiting[0]}-{uuid4()}"
                    future = self._client.submit(work, tasks[waiting[0]], key=key)
                except Exception:  # of any kind, where the scheduler has just ended
                    break
                submitted[future] = waiting.popleft()
                future.add_done_callback(ended.put)
            try:
                future = ended.get(timeout=_LOOK_S)
            except Empty:
                continue
            outcome = _outcome(future)
            number = submitted.pop(future)
            if outcome is None:
                waiting.appendleft(number)
            else:
                yield number, outcome[0]

    def _cores(self) -> int:
        """Return the number of cores of all workers, 0 if there is none now.

        Raises ClusterError if there is none for `_AWAY_S`.
        """
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

        Connects anew if the connection has been given up; may block for `_ANSWER_S`.
        """
        try:
            if self._client.status == "closed":  # it has tried to connect again for long enough
                self._client = self._connect()
            found = self._client.sync(self._client.scheduler.ncores, callback_timeout=_ANSWER_S)
        except Exception:  # of any kind, while the scheduler is away
            return 0
        return sum(found.values())

    def _connect(self) -> "Client":
        """Return a new connection; blocks for up to `_CONNECTING_S`."""
        from distributed import Client

        return Client(self._address, timeout=_CONNECTING_S, set_as_default=False, name="lipservo")


def _outcome(future: "Future") -> tuple[Any] | None:
    """Return the result of a task, in a tuple; None if the task was lost and must be repeated.

    A ClusterError is the result of a task that Dask gave up. Raises what the work itself raised.
    """
    from distributed import KilledWorker

    try:
        return (future.result(timeout=_AWAY_S),)
    except KilledWorker as error:
        return (ClusterError(f"the Dask workers failed: {_one_line(error)}"),)
    except _LOST:
        if future.status == "error":
            raise  # the work itself raised it
        return None


def _one_line(error: object) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]
