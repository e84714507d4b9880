"""The record of a tick says what status and report say."""

import numpy as np

from firmware_bridge.clock import ManualClock
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.runtime.status.live_board import FACE_STATES, BoardLayout, LiveBoard, ServoBoard

JOINTS = [Joint(f"joint_{n}", n, -40.0, 40.0, 300.0) for n in (1, 2)]


def test_the_record_of_a_tick_equals_status_and_report():
    clock, channel = ManualClock(), MemoryTargetChannel()
    layout = BoardLayout("bench", "bench", ("joint_1", "joint_2"), FACE_STATES, (), 1, 100.0)
    with SimulatedBus(JOINTS, clock) as bus, LiveBoard.create(layout) as live:
        bridge = Bridge(bus, JOINTS, channel, BridgeSettings(100.0))
        board = ServoBoard(live, bridge)
        bridge.start()
        for n in range(300):
            clock.advance(0.01)
            if n < 250:  # then targets grow stale
                channel.publish(ServoTargets(clock.now(), np.array([10.0, -5.0])))
            report = bridge.tick(clock.now(), late=n % 2)
            board.tell(report)
        ((_, record),) = live.servos_since(299)
        counts, feedback = bridge.counts, bridge.feedback

    assert FACE_STATES[record["state"]] == bridge.state.value
    told = [int(record[name]) for name in ("n_ticks", "n_late", "n_stale")]
    assert told == [counts.n_ticks, counts.n_late, counts.n_stale]
    assert told[0] == 300
    assert told[1] == 150
    assert told[2] > 0
    assert record["torque_on"]
    np.testing.assert_allclose(record["goal_deg"], report.sent_deg, rtol=1e-6)
    np.testing.assert_allclose(record["encoder_deg"], feedback.positions_deg, rtol=1e-6)
    np.testing.assert_allclose(record["effort"], feedback.effort, rtol=1e-6)
