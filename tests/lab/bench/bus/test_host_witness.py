"""A turn in which the computer stood still is told from one that was slow by itself."""

import os
import signal
import struct
import time

import pytest
from lipservo_lab.bench.bus.host_witness import HostWitness


def test_what_was_measured_while_a_core_stood_still_is_known():
    reader, writer = os.pipe()
    witness = HostWitness(reader)
    os.write(writer, struct.pack("<4d", 10.0, 10.1, 20.0, 20.01))
    witness.settle()

    assert witness.saw_stall(9.0, 10.05)
    assert witness.saw_stall(10.02, 10.03)
    assert witness.saw_stall(19.0, 21.0)
    assert not witness.saw_stall(10.2, 19.9)
    os.close(writer)
    os.close(reader)


def test_a_witness_that_has_ended_is_no_quiet_computer():
    reader, writer = os.pipe()
    os.close(writer)
    with pytest.raises(RuntimeError, match="has ended"):
        HostWitness(reader).settle()
    os.close(reader)


def test_a_witness_that_is_held_up_reports_it():
    """SIGSTOP in place of a host that lends its core to somebody else."""
    others = _children()  # of tests that ran before in this process
    with HostWitness.watching() as witness:
        pids = sorted(_children() - others)
        assert len(pids) == len(os.sched_getaffinity(0))
        begin_s = time.monotonic()
        os.kill(pids[0], signal.SIGSTOP)
        time.sleep(0.1)
        os.kill(pids[0], signal.SIGCONT)
        witness.settle()
        assert witness.saw_stall(begin_s, time.monotonic())
    assert not _children() - others


def _children():
    pid = os.getpid()
    with open(f"/proc/{pid}/task/{pid}/children") as file:
        return {int(each) for each in file.read().split()}
