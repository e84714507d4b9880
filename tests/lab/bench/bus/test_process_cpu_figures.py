"""What `bench bus` compares are processes that really drive servos, ours and the others'."""

import mmap
import os
import struct
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.bench.bus import process_cpu_figures
from lipservo_lab.bench.bus import process_cpu_figures as measured_process
from lipservo_lab.bench.bus.servo_clients import (
    CLIENTS,
    AnswerLost,
    RustypotClient,
    canned_peer,
    run,
)

from firmware_bridge.loop.targets import ServoTargets, SocketTargetChannel, channel_pair
from lipsync.errors import UserError


class Recorder:
    """A client that loses every second answer."""

    def __init__(self):
        self.sent = []

    def work(self, goals):
        self.sent.append(list(goals))
        if len(self.sent) % 2:
            raise AnswerLost


def test_a_client_loop_sends_the_newest_goals_counts_its_rounds_and_ends_with_its_socket():
    writer, reader = channel_pair()
    count, client, lost = os.memfd_create("rounds"), Recorder(), []
    os.ftruncate(count, 8)
    loop = threading.Thread(
        target=lambda: lost.append(run(client, 2, 1000.0, reader.detach(), count))
    )
    channel = SocketTargetChannel(writer)
    for deg in (10.0, 45.0):
        channel.publish(ServoTargets(0.0, np.array([deg, -deg])))
    loop.start()
    while len(client.sent) < 4:
        time.sleep(0.001)
    writer.close()
    loop.join(10.0)

    assert client.sent[0] == [2048 + 512, 2048 - 512]
    with mmap.mmap(count, 0) as counted:
        assert struct.unpack_from("<Q", counted)[0] == len(client.sent)
    assert lost == [(len(client.sent) + 1) // 2]
    os.close(count)


def test_health_read_in_turn_is_what_our_tick_reads():
    pytest.importorskip("rustypot")
    with canned_peer(2) as port:
        client, found = RustypotClient(port, 2), []
        for _ in range(40):
            try:
                found.append(client.work([2048] * 2))
            except AnswerLost:
                continue

    for currents, positions, health in found:
        assert len(currents) == len(positions) == 2
        assert len(health) in (2, 3)
    warmths = [each[2] for each in found if len(each[2]) == 2]
    states = [each[2] for each in found if len(each[2]) == 3]
    assert all(40 < tenths_v < 80 and 0 < degc < 80 for tenths_v, degc in warmths)
    assert states
    assert all(state == [0, 0, 0] for state in states)  # limp, well, no watchdog


def test_every_loop_that_is_compared_can_be_made():
    kinds = {*process_cpu_figures.AT_ONCE.loops, *process_cpu_figures.ON_THE_WIRE.loops}
    with canned_peer(2) as port:
        for kind in kinds:
            if kind != "rustypot":
                assert len(CLIENTS[kind](port, 2).work([2048] * 2)) == 4


@pytest.mark.slow
def test_the_figures_of_processes_have_the_names_that_are_promised(monkeypatch):
    for name in ("_SETTLES_S", "_COUNTED_S", "_FULL_STRENGTH_S"):
        monkeypatch.setattr(measured_process, name, 0.3)
    peer = process_cpu_figures.AT_ONCE.peer  # at both: a simulator takes its time to start
    for name in ("AT_ONCE", "ON_THE_WIRE"):
        comparison = getattr(process_cpu_figures, name)
        short = replace(comparison, peer=peer, loops={"sdk": comparison.loops["sdk"]}, n_turns=2)
        monkeypatch.setattr(process_cpu_figures, name, short)

    try:
        figures = process_cpu_figures.process_ratios()
    except UserError as error:  # so short a measurement is lost whole to a busy computer
        if "stood still" not in str(error):
            raise
        pytest.skip(str(error))

    promised = {"cpu_process_us", "cpu_process_ratio", "cpu_process_wire_ratio"}
    assert promised <= {*figures}
    assert all(value > 0.0 for value in figures.values())
