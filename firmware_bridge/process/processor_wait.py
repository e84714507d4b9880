"""How long the threads of a process have waited for a processor, by what Linux counts."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

_RUNNABLE = b"R"


@dataclass(frozen=True, slots=True)
class ThreadCount:
    """What the kernel counts of one thread, in ns: time it ran, and time it waited to run.

    A wait is counted when it ends. runnable: the thread runs or waits now.
    """

    runnable: bool
    ran_ns: int
    waited_ns: int


def thread_counts(pid: int) -> dict[str, ThreadCount]:
    """Return the counts of all threads of a process, by id; {} where the kernel does not tell."""
    counts = {}
    with contextlib.suppress(OSError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError, ValueError, IndexError):  # one that just ended
                ran, waited, _ = (thread / "schedstat").read_bytes().split()
                # The name in parentheses before the state may contain anything.
                state = (thread / "stat").read_bytes().rpartition(b")")[2].split()[0]
                counts[thread.name] = ThreadCount(state == _RUNNABLE, int(ran), int(waited))
    return counts


class ProcessorWait:
    """The longest wait of any thread since the first reading; times are monotonic seconds."""

    def __init__(self) -> None:
        self._first: dict[str, ThreadCount] = {}
        self._unchanged: dict[str, tuple[ThreadCount, float]] = {}

    def waited_s(self, now_s: float, counts: Mapping[str, ThreadCount]) -> float:
        """Return the seconds that a thread has waited, the present wait included, by `counts`.

        A thread waits now if it is runnable and has neither run nor been given a processor since an
        earlier reading.
        """
        longest_s = 0.0
        for thread, count in counts.items():
            first = self._first.setdefault(thread, count)
            before, since_s = self._unchanged.get(thread, (None, now_s))
            if count != before:
                since_s = now_s
                self._unchanged[thread] = count, now_s
            present_s = now_s - since_s if count.runnable else 0.0
            longest_s = max(longest_s, (count.waited_ns - first.waited_ns) * 1e-9 + present_s)
        return longest_s
