"""A tenth of a processor for some processes, by a control group.

Not by processes that run before all others: those would starve the kernel's own threads too, which
carry the bytes of serial ports.
"""

import contextlib
import os
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from lipsync.errors import UserError

#: At a tenth a group's processes wait for nine tenths of each period once they have had theirs:
#: from 18 ms to .9 s on end, another period every few seconds.
_PERIODS_US: Final = (20_000, 100_000, 300_000, 1_000_000)
_CHANGES_S: Final = 3.0
#: Its weight against other processes, so that these take no part of the share: of a hundred.
_WEIGHTS: Final = {"cpu.weight": "10000", "cpu.shares": "102400"}
_GROUPS: Final = Path("/sys/fs/cgroup")


class ProcessorShare:
    """A Linux control group whose processes together get a share of one processor.

    They run in one piece in each period; the length of the period changes now and then. share: 0 to
    1; a change takes effect with the next period.
    """

    def __init__(self, folder: Path, share: float) -> None:
        self.share = share
        self._folder = folder
        self._chance = random.Random(0)
        self._changes_s = 0.0

    def keep(self, pid: int) -> None:
        """Put a process and its threads into the group; change the period if that is due.

        Threads get ordinary scheduling, for real-time ones are not counted, or not let in. A
        process that has ended is ignored.
        """
        with contextlib.suppress(OSError):
            for thread in os.listdir(f"/proc/{pid}/task"):  # others are not counted, or not let in
                os.sched_setscheduler(int(thread), os.SCHED_OTHER, os.sched_param(0))
            (self._folder / "cgroup.procs").write_text(str(pid))
        if time.monotonic() >= self._changes_s:
            self._changes_s = time.monotonic() + _CHANGES_S
            self.set_period(self._chance.choice(_PERIODS_US))

    def set_period(self, period_us: int) -> None:
        """Set the length of a period, and the share of it that the group gets. Raises OSError."""
        quota_us = round(self.share * period_us)
        # Control groups of version 2; below, of version 1, where the quota must never exceed the
        # period.
        if (self._folder / "cpu.max").exists():
            (self._folder / "cpu.max").write_text(f"{quota_us} {period_us}")
            return
        (self._folder / "cpu.cfs_quota_us").write_text("-1")
        (self._folder / "cpu.cfs_period_us").write_text(str(period_us))
        (self._folder / "cpu.cfs_quota_us").write_text(str(quota_us))


@contextlib.contextmanager
def processor_share(kind: str, share: float) -> Iterator[ProcessorShare]:
    """Make a control group that gets a share of a processor; yield it, still without processes.

    kind: part of its name. The group is removed at the end if its processes have ended. Raises
    UserError where the system does not permit it.
    """
    first = _GROUPS / "cpu"
    folder = (first if first.exists() else _GROUPS) / f"lipservo-bench-{kind}-{os.getpid()}"
    try:
        if not first.exists():
            (_GROUPS / "cgroup.subtree_control").write_text("+cpu")
        folder.mkdir()
        group = ProcessorShare(folder, share)
        group.set_period(_PERIODS_US[0])
        for name, weight in _WEIGHTS.items():
            if (folder / name).exists():
                (folder / name).write_text(weight)
    except OSError as error:
        with contextlib.suppress(OSError):
            folder.rmdir()
        raise UserError(
            f"--starved: needs a control group that limits processors, thus root: {error}"
        ) from error
    try:
        yield group
    finally:
        with contextlib.suppress(OSError):
            folder.rmdir()
