"""How long the threads of a process have waited for a processor, by what Linux counts."""

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path

#: Of each thread, by id: whether it runs or waits now, and the ns that it has run and has waited to
#: run. A wait is counted when it ends.
ThreadCounts = Mapping[str, tuple[bool, int, int]]
CountThreads = Callable[[], ThreadCounts]


def thread_counts(pid: int) -> ThreadCounts:
    """Return (is runnable, ns run, ns waited for a processor) of a process's threads, by thread id.

    {} where the kernel does not count that, or the process has ended.
    """
    counts = {}
    with contextlib.suppress(OSError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError, ValueError, IndexError):  # one that just ended
                ran, waited, _ = (thread / "schedstat").read_bytes().split()
                # The name in parentheses before the state may contain anything.
                state = (thread / "stat").read_bytes().rpartition(b")")[2].split()[0]
                counts[thread.name] = state == b"R", int(ran), int(waited)
    return counts


class ProcessorWait:
    """The longest wait of any thread since the first reading; times are monotonic seconds."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[int, tuple[bool, int, int], float]] = {}

    def waited_s(self, now_s: float, counts: ThreadCounts) -> float:
        """Return how many seconds a thread has waited for a processor, of the one that waited most.

        Counted from the first call on, the present wait included. counts: of the process's threads
        now. A thread waits now if it is runnable and has neither run nor been given a processor
        since an earlier call.
        """
        longest_s = 0.0
        for thread, count in counts.items():
            runnable, _, waited_ns = count
            first_ns, before, since_s = self._seen.get(thread, (waited_ns, count, now_s))
            since_s = since_s if count == before else now_s
            self._seen[thread] = first_ns, count, since_s
            present_s = now_s - since_s if runnable else 0.0
            longest_s = max(longest_s, (waited_ns - first_ns) * 1e-9 + present_s)
        return longest_s
