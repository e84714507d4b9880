"""Servos switched off, on and restarted by a person while the others go on: what they confirm."""

import numpy as np
import pytest
from driven_robot import RATE_HZ, TORQUE_ON, Robot, speech_deg
from dynamixel_chain import MemoryFace, mounted

from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.loop.torque_gate import TorqueGate
from firmware_bridge.simulator.faults import Fault
from firmware_bridge.stopping import ServoOrder, ServoSwitch, StopLevel

JOINT_2 = 1
PULSES_PER_DEG = 4096 / 360


def torque_writes_to(robot, servo_id, since_s):
    return [
        time_s
        for time_s, data in robot.face.written
        if time_s > since_s and data[4] == servo_id and data[7:11] == TORQUE_ON
    ]


def steps_deg(robot, index, from_s, to_s):
    """How far one shaft moved in each tick."""
    places = [position[index] for time_s, _, position in robot.seen if from_s <= time_s < to_s]
    return np.abs(np.diff(places)) / PULSES_PER_DEG


def test_a_servo_switched_off_confirms_it_and_stays_off_over_a_pulled_plug():
    robot = Robot(Fault("unplug", at_s=(3.5,), lasts_s=1.0), stops=[(8.0, "soft")])
    found = {}

    def look(key):
        found[key] = robot.state("joint_2"), robot.bridge.troubles

    robot.live(
        60.0,
        {
            2.0: lambda: found.update(answer=robot.say("servo joint_2 off")),
            2.2: lambda: look("soon"),
            4.0: lambda: look("unplugged"),
            7.5: lambda: look("late"),
        },
    )

    assert found["answer"] == {"servo": "joint_2", "asked": "off"}
    assert found["soon"] == ("off", ("servo 'joint_2' (id 2) switched off by a person",))
    assert found["unplugged"][0] == "switching off"  # nobody can say so any more
    assert found["late"] == found["soon"]
    assert not any(torque[JOINT_2] for time_s, torque, _ in robot.seen if time_s > 2.07)
    assert torque_writes_to(robot, 2, 2.0) == []
    assert all(torque[0] and torque[2] for time_s, torque, _ in robot.seen if 6.5 < time_s < 7.9)
    assert steps_deg(robot, 0, 2.5, 3.4).max() > 1.0  # the others go on
    assert robot.told.switches == [(JOINT_2, False)]
    assert any("servo joint_2 off: asked by a test" in line for line in robot.log)


def test_off_counts_as_confirmed_only_once_the_servo_has_said_so():
    robot = Robot(
        Fault("silence", servos=(JOINT_2,), at_s=(2.0,), lasts_s=1.5), stops=[(5.0, "soft")]
    )
    found = {}
    robot.live(
        60.0,
        {
            2.1: lambda: robot.say("servo joint_2 off"),
            3.0: lambda: found.update(silent=(robot.state("joint_2"), robot.bridge.troubles)),
            4.5: lambda: found.update(back=robot.state("joint_2")),
        },
    )

    assert found["silent"][0] == "switching off"
    assert "switched off by a person, has not confirmed" in found["silent"][1][0]
    assert found["back"] == "off"
    assert not any(torque[JOINT_2] for time_s, torque, _ in robot.seen if time_s > 4.1)


def test_torque_that_somebody_else_switches_on_goes_off_again():
    robot = Robot(stops=[(6.0, "soft")])

    def meddle():
        robot.face.chain.servos[JOINT_2].write(bytes((64, 0, 1)))

    robot.live(60.0, {2.0: lambda: robot.say("servo joint_2 off"), 3.0: meddle})

    assert any(torque[JOINT_2] for time_s, torque, _ in robot.seen if 2.9 < time_s < 3.3)
    assert not any(torque[JOINT_2] for time_s, torque, _ in robot.seen if time_s > 4.0)


@pytest.mark.parametrize("tolerant", [True, False])
def test_the_next_process_leaves_it_off(tolerant):
    robot = Robot(stops=[(4.0, "soft")], switched_off=[JOINT_2], tolerant=tolerant)
    found = {}
    robot.live(60.0, {3.0: lambda: found.update(state=robot.state("joint_2"))})

    assert found["state"] == "off"
    assert not any(torque[JOINT_2] for _, torque, _ in robot.seen)
    assert torque_writes_to(robot, 2, -1.0) == []
    assert all(torque[0] for time_s, torque, _ in robot.seen if 2.0 < time_s < 3.5)


def test_a_frozen_face_taken_over_keeps_the_others_and_lets_that_one_go():
    """It was told to go limp, the bridge died before it did, and the face had been frozen."""
    face = MemoryFace(3, strict=False)
    settings = BridgeSettings(RATE_HZ, tolerant=True, switched_off=[JOINT_2])
    bridge = Bridge(face.bus, face.joints, MemoryTargetChannel(), settings)
    for servo in face.chain.servos:
        servo["torque_enable"] = 1
    with face.bus:
        bridge.start_frozen()
        for tick in range(30):
            face.clock.sleep_until(tick / RATE_HZ)
            bridge.tick(tick / RATE_HZ)
        torque = [servo.torque_on for servo in face.chain.servos]
        bridge.obey(ServoOrder("joint_2", ServoSwitch.ON), 1.0)
        for tick in range(30, 60):
            face.clock.sleep_until(tick / RATE_HZ)
            bridge.tick(tick / RATE_HZ)
        after_on = [servo.torque_on for servo in face.chain.servos]

    assert torque == after_on == [True, False, True]  # what is taken is done at the start


def test_it_comes_on_where_it_stands_and_goes_slowly_to_where_it_is_wanted():
    robot = Robot(stops=[(5.5, "soft")])

    def push():
        robot.face.chain.motors.position[JOINT_2] += 25 * PULSES_PER_DEG

    robot.live(
        60.0,
        {
            2.0: lambda: robot.say("servo joint_2 off"),
            2.5: push,
            3.0: lambda: robot.say("servo joint_2 on"),
        },
    )

    (switched_on_s,) = torque_writes_to(robot, 2, 2.5)
    assert switched_on_s < 3.2
    way = [(t, deg[JOINT_2]) for t, deg in robot.sent_deg if switched_on_s < t < 5.4]
    off_deg = [deg - speech_deg(t, 3)[JOINT_2] for t, deg in way]
    met = int(np.argmax(np.abs(off_deg) < 1e-6))
    goals_deg = np.array([deg for _, deg in way])
    assert met > 3
    assert np.abs(np.diff(goals_deg[:met])).max() <= 30.0 / RATE_HZ + 1e-9
    assert steps_deg(robot, JOINT_2, 3.0, way[met][0]).max() < 2.0 * 30.0 / RATE_HZ
    assert np.abs(off_deg[met:]).max() < 1e-6  # from then on it follows speech, like the others
    assert robot.told.switches == [(JOINT_2, False), (JOINT_2, True)]


def test_a_servo_that_was_given_up_is_tried_again():
    robot = Robot(stops=[(4.0, "soft")], given_up={JOINT_2: "does not follow: it stays limp"})
    found = {}
    robot.live(
        60.0,
        {
            1.0: lambda: found.update(before=(robot.state("joint_2"), *robot.bridge.troubles)),
            1.1: lambda: robot.say("servo joint_2 on"),
            3.0: lambda: found.update(after=(robot.state("joint_2"), *robot.bridge.troubles)),
        },
    )

    assert found["before"][0] == "failed"
    assert "it stays limp" in found["before"][1]
    assert found["after"] == ("driven",)
    assert robot.bridge.given_up == {}
    assert robot.told.switches == [(JOINT_2, True)]


def test_it_gets_no_torque_while_something_is_in_the_way_and_the_face_says_what():
    robot = Robot(stops=[(4.0, "soft")])
    found = {}

    def exchange():
        robot.face.chain.servos[JOINT_2]["homing_offset"] = 500
        robot.say("servo joint_2 on")

    robot.live(
        60.0,
        {
            2.0: lambda: robot.say("servo joint_2 off"),
            2.3: exchange,
            3.8: lambda: found.update(troubles=robot.bridge.troubles),
        },
    )

    assert "has homing offset 500" in found["troubles"][0]
    assert torque_writes_to(robot, 2, 2.0) == []


@pytest.mark.parametrize("level", ["soft", "limp", "freeze"])
def test_after_a_stop_by_a_person_nothing_switches_torque_on(level):
    robot = Robot(stops=[(3.0, level), (5.0, "soft")])
    refused, taken = [], []

    def ask():
        words = ("servo joint_2 reboot", "jog arm", "jog joint_1 3")
        refused.extend(robot.say(word) for word in words)
        taken.append(robot.say("servo joint_2 on"))  # for the next start

    robot.live(
        60.0,
        {2.0: lambda: robot.say("servo joint_2 off"), 3.0: ask},
    )

    assert all(set(answer) == {"error"} for answer in refused)
    assert all("\n" not in answer["error"] for answer in refused)
    assert f"stopped by a person ({level})" in refused[0]["error"]
    assert taken == [{"servo": "joint_2", "asked": "on"}]
    assert robot.torque_writes(3.0) == []


def test_the_gate_itself_gives_no_torque_to_whom_a_person_switched_off():
    face = MemoryFace(2)
    gate = TorqueGate(face.bus, switched_off=[0])
    gate.give_up(1, "jammed")
    with face.bus:
        assert gate.enable(0) == gate.obstacle(0) == "switched off by a person"
        assert not gate.keep(0)
        gate.switch_off(1)
        assert gate.enable(1) == "switched off by a person"
        assert [servo.torque_on for servo in face.chain.servos] == [False, False]
        gate.switch_on(1)
        assert gate.enable(1) == ""
        assert [servo.torque_on for servo in face.chain.servos] == [False, True]


def test_a_frozen_servo_may_be_let_go():
    robot = Robot(stops=[(2.0, "freeze"), (4.0, "soft")])
    robot.live(60.0, {3.0: lambda: robot.say("servo joint_2 off")})

    assert all(torque[JOINT_2] for time_s, torque, _ in robot.seen if 2.2 < time_s < 2.9)
    held = [torque for time_s, torque, _ in robot.seen if 3.2 < time_s < 3.9]
    assert all(torque == [True, False, True] for torque in held)


def test_in_a_dry_run_everything_is_refused():
    robot = Robot(stops=[(3.0, "soft")], dry_run=True)
    refused = []
    words = [f"servo joint_2 {each}" for each in ("off", "on", "reboot")] + ["jog arm", "jog end"]
    robot.live(60.0, {2.0: lambda: refused.extend(robot.say(word) for word in words)})

    assert refused == [{"error": "dry run: servos are only read"}] * 5


def test_a_critical_servo_is_not_switched_off_and_unknown_ones_are_named():
    servos = [*mounted(2), *mounted(3, critical=True)[2:]]
    robot = Robot(servos=servos, stops=[(3.0, "soft")])
    refused = []
    words = ("servo joint_3 off", "servo nose off", "servo joint_1 dance", "servo joint_1")
    robot.live(60.0, {2.0: lambda: refused.extend(robot.say(word)["error"] for word in words)})

    assert refused == [
        "servo 'joint_3' (id 3) is critical: the face cannot go on without it; stop it",
        "'nose': no such servo; there are: joint_1, joint_2, joint_3",
        "say: servo NAME off|on|reboot",
        "say: servo NAME off|on|reboot",
    ]
    assert all(all(torque) for time_s, torque, _ in robot.seen if 1.0 < time_s < 2.9)


def test_a_servo_is_restarted_only_while_it_is_not_driven_and_is_what_it_was_afterwards():
    robot = Robot(stops=[(6.0, "soft")])
    found = {}

    def look(key):
        found[key] = robot.state("joint_2"), robot.bridge.servo_health()[JOINT_2].n_reboots

    robot.live(
        60.0,
        {
            1.5: lambda: found.update(refused=robot.say("servo joint_2 reboot")),
            2.0: lambda: robot.say("servo joint_2 off"),
            2.3: lambda: found.update(taken=robot.say("servo joint_2 reboot")),
            2.5: lambda: look("during"),
            4.0: lambda: look("after"),
            4.1: lambda: robot.say("servo joint_2 on"),
            5.5: lambda: look("on"),
        },
    )

    assert "is driven; switch it off first" in found["refused"]["error"]
    assert found["taken"] == {"servo": "joint_2", "asked": "reboot"}
    assert found["during"] == ("switching off", 1)
    assert found["after"] == ("off", 1)
    assert found["on"] == ("driven", 1)
    reboots = [t for t, data in robot.face.written if data[4:8] == bytes((2, 3, 0, 8))]
    assert len(reboots) == 1


def test_switched_off_in_a_silence_it_stays_limp_when_the_others_wake():
    face = MemoryFace(3, strict=False)
    channel = MemoryTargetChannel()
    bridge = Bridge(face.bus, face.joints, channel, BridgeSettings(RATE_HZ, tolerant=True))
    with face.bus:
        bridge.start()
        for tick in range(round(12.0 * RATE_HZ)):
            time_s = tick / RATE_HZ
            face.clock.sleep_until(time_s)
            if tick == round(7.0 * RATE_HZ):
                assert bridge.state is FaceState.SILENT
                assert bridge.obey(ServoOrder("joint_2", ServoSwitch.OFF), time_s) == ""
            if tick == round(8.0 * RATE_HZ):
                silent = bridge.servo_health()[JOINT_2].state
            if time_s < 1.0 or time_s > 9.0:
                channel.publish(ServoTargets(time_s, speech_deg(time_s, 3)))
            bridge.tick(time_s)
        states = [each.state for each in bridge.servo_health()]
        bridge.stop(StopLevel.LIMP)

    assert silent == "off"
    assert states == ["driven", "off", "driven"]
