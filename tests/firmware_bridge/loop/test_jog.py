"""Joints in a person's hand while the others go on with speech: how far, how fast, how it ends."""

import numpy as np
import pytest
from driven_robot import RATE_HZ, Robot, speech_deg
from dynamixel_chain import MemoryFace
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.campaigns.auditor import Auditor

from firmware_bridge.gate.limits import PreventRule
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.stopping import ArmJog, JogTo, StopLevel

#: The fastest that a jogged joint may be told to go, in a tick.
STEP_DEG = 30.0 / RATE_HZ + 1e-9


def goals(robot, index, from_s, to_s):
    """Times and goals of one joint."""
    found = [(time_s, deg[index]) for time_s, deg in robot.sent_deg if from_s <= time_s < to_s]
    return np.array(found).T


def jogged_robot(at, until_s=10.0, **options):
    """A robot to which words are said at their moments; (robot, answers by moment)."""
    robot, answers = Robot(stops=[(until_s, "soft")], **options), {}
    moments = {
        moment_s: lambda word=word, m=moment_s: answers.update({m: robot.say(word)})
        for moment_s, word in at.items()
    }
    robot.live(60.0, moments)
    return robot, answers


def renewed(word, from_s, to_s):
    """The same word twice a second."""
    return {float(moment_s): word for moment_s in np.arange(from_s, to_s, 0.5)}


def test_a_jogged_joint_goes_slowly_to_its_angle_and_stays_while_the_others_go_on():
    undisturbed, _ = jogged_robot({}, 5.0)
    jogged, answers = jogged_robot({2.0: "jog arm", **renewed("jog joint_2 -32.5", 2.1, 4.9)}, 5.0)

    assert answers[2.0] == {"jog": "arm"}
    assert answers[2.1] == {"jog": "joint_2", "position_deg": -32.5}
    _, way = goals(jogged, 1, 2.1, 5.0)
    assert np.abs(np.diff(way)).max() <= STEP_DEG
    assert way[-1] == pytest.approx(-32.5)
    for index in (0, 2):
        expected, found = goals(undisturbed, index, 0.0, 4.9), goals(jogged, index, 0.0, 4.9)
        np.testing.assert_allclose(found, expected)
    # So is the shaft: joint_2 is mounted the other way round, its zero 2 degrees off.
    position = next(p for t, _, p in jogged.seen if t > 4.8)[1]
    assert (position - 2048) * 360 / 4096 == pytest.approx(32.5 - 2.0, abs=0.5)


@pytest.mark.parametrize("end", ["a word", "silence"])
def test_after_the_end_it_goes_back_as_slowly_and_then_follows_speech_again(end):
    at = {2.0: "jog arm", 2.1: "jog joint_2 35", **renewed("jog arm", 2.5, 4.1)}
    if end == "a word":
        at[4.5] = "jog end"
    ended_s = 4.5 if end == "a word" else 4.0 + 3.0
    end_s = ended_s + 3.0
    robot, _ = jogged_robot(at, end_s)
    undisturbed, _ = jogged_robot({}, end_s)

    _, held = goals(robot, 1, 3.8, ended_s)
    assert np.ptp(held) < 1e-9
    times_s, back = goals(robot, 1, ended_s, end_s - 0.1)
    _, wanted = goals(undisturbed, 1, ended_s, end_s - 0.1)
    met = int(np.argmax(np.abs(back - wanted) < 1e-6))
    assert 0.0 < times_s[met] - ended_s < 3.0
    assert np.abs(np.diff(back[:met])).max() <= STEP_DEG
    np.testing.assert_allclose(back[met:], wanted[met:], atol=1e-6)
    # No jump anywhere, as the shaft itself moved.
    shaft = [position[1] for time_s, _, position in robot.seen if time_s > 2.0]
    assert np.abs(np.diff(shaft)).max() * 360 / 4096 <= 1.1 * 300.0 / RATE_HZ


def test_several_joints_are_jogged_at_once_and_the_status_names_them():
    robot = Robot(stops=[(5.0, "soft")])
    found = {}
    robot.live(
        60.0,
        {
            2.0: lambda: robot.say("jog arm"),
            2.1: lambda: robot.say("jog joint_3 5"),
            2.5: lambda: robot.say("jog joint_1 -5"),
            3.5: lambda: found.update(during=robot.bridge.jogged),
            4.0: lambda: robot.say("jog end"),
            4.2: lambda: found.update(after=robot.bridge.jogged),
        },
    )

    assert found == {"during": ("joint_1", "joint_3"), "after": ()}
    for index, goal_deg in ((0, -5.0), (2, 5.0)):
        assert goals(robot, index, 3.5, 3.9)[1] == pytest.approx(goal_deg)


REFUSED = [
    ("jog joint_2 3", "jogging is not armed: say `jog arm` first"),
    ("jog arm", ""),
    ("jog end", ""),
    ("jog joint_2 3", "jogging is not armed"),
    ("jog arm", ""),
    ("jog joint_2 40.5", "joint_2 is 40.5 deg; allowed: -40 to 40 deg"),
    ("jog joint_2 nan", "joint_2 is nan deg; allowed: -40 to 40 deg"),
    ("jog joint_2 -inf", "joint_2 is -inf deg; allowed"),
    ("jog joint_2 far", "'far' is not a number"),
    ("jog nose 3", "'nose': no such servo; there are: joint_1, joint_2"),
    ("jog joint_2", "say: jog arm, jog NAME DEG, or jog end"),
    ("jog", "say: jog arm, jog NAME DEG, or jog end"),
]


def test_what_is_refused_is_one_line_and_moves_nothing():
    at = {2.0 + 0.05 * n: word for n, (word, _) in enumerate(REFUSED)}
    robot, answers = jogged_robot(at, 4.0)
    undisturbed, _ = jogged_robot({}, 4.0)

    for (word, said), answer in zip(REFUSED, answers.values(), strict=True):
        assert answer.get("error", "").startswith(said), word
        assert (set(answer) == {"error"}) == bool(said), word
    for index in range(3):
        expected, found = goals(undisturbed, index, 0.0, 3.9), goals(robot, index, 0.0, 3.9)
        np.testing.assert_allclose(found, expected)


def test_a_servo_that_is_switched_off_cannot_be_jogged_and_is_in_nobodys_hand_any_more():
    robot, answers = jogged_robot(
        {
            2.0: "jog arm",
            2.1: "jog joint_2 5",
            2.5: "servo joint_2 off",
            3.0: "jog joint_2 6",
        },
        5.0,
    )

    assert answers[3.0] == {"error": "servo 'joint_2' (id 2) switched off by a person"}
    assert not any(torque[1] for time_s, torque, _ in robot.seen if time_s > 2.6)


@pytest.mark.parametrize("level", ["soft", "limp", "freeze"])
def test_every_stop_ends_it(level):
    robot = Robot(stops=[(4.0, level), (7.0, "soft")])
    robot.live(
        60.0,
        {2.0: lambda: robot.say("jog arm"), 2.1: lambda: robot.say("jog joint_2 35")},
    )

    assert robot.bridge.jogged == ()
    assert robot.stiff == []
    steps = np.abs(np.diff(goals(robot, 1, 4.0, 7.0)[1]))
    if level == "freeze":
        assert steps.max(initial=0.0) < 0.2  # it stays where it came to a stand
    if level == "soft":
        assert goals(robot, 1, 4.0, 7.0)[1][-1] == pytest.approx(0.0)
        assert steps.max() <= 300.0 / RATE_HZ + 1e-9


def jogged_bridge(spoken_to_until_s, jog_until_s, seconds, **options):
    """A bridge whose first joint is held at 10 degrees, tick by tick: its goals and states."""
    face = MemoryFace(3, strict=False)
    channel = MemoryTargetChannel()
    bridge = Bridge(
        face.bus, face.joints, channel, BridgeSettings(RATE_HZ, tolerant=True, **options)
    )
    sent, states = [], []
    with face.bus:
        bridge.start()
        for tick in range(round(seconds * RATE_HZ)):
            time_s = tick / RATE_HZ
            face.clock.sleep_until(time_s)
            if time_s < spoken_to_until_s:
                channel.publish(ServoTargets(time_s, speech_deg(time_s, 3)))
            if 1.0 < time_s < jog_until_s:
                bridge.obey(ArmJog(), time_s)
                bridge.obey(JogTo("joint_1", 10.0), time_s)
            sent.append(bridge.tick(time_s).sent_deg)
            states.append(bridge.state)
        torque = [servo.torque_on for servo in face.chain.servos]
        jogged = bridge.jogged
    return np.array(sent), states, torque, jogged


def test_a_silent_speech_side_makes_a_jogged_face_limp_as_ever():
    """Whoever jogs is no reason to hold the others where nobody wants them."""
    sent, states, torque, jogged = jogged_bridge(2.0, 60.0, 9.0)

    assert sent[round(6.0 * RATE_HZ), 0] == pytest.approx(10.0)
    assert sent[round(6.0 * RATE_HZ), 1:] == pytest.approx(0.0)
    assert states[-1] is FaceState.SILENT
    assert (torque, jogged) == ([False] * 3, ())


def test_rules_between_joints_hold_for_jogged_ones():
    rule = PreventRule((1.0, 1.0, 0.0), 6.0, "they touch")
    sent, *_ = jogged_bridge(60.0, 6.0, 6.0, prevent=[rule])

    assert (sent[:, 0] + sent[:, 1]).max() <= 6.0 + 1e-6
    assert sent[:, 0].max() > 5.0  # when the other makes room, it goes on


NAMES = ["joint_1", "joint_2", "joint_3", "nose"]
words = st.one_of(
    st.builds("servo {} {}".format, st.sampled_from(NAMES), st.sampled_from(["off", "on"])),
    st.builds("servo {} reboot".format, st.sampled_from(NAMES)),
    st.builds("jog {} {}".format, st.sampled_from(NAMES), st.floats(-45.0, 45.0)),
    st.sampled_from(["jog arm", "jog arm", "jog arm", "jog end", "jog joint_1 nan", "jog"]),
)
moments = st.tuples(st.integers(15, 120).map(lambda tick: tick / RATE_HZ), words)
ends = st.sampled_from(["soft", "limp", "freeze"])


class Tap(list):
    """Lets an auditor see what is written, too."""

    def __init__(self, auditor):
        super().__init__()
        self.auditor = auditor

    def append(self, item):
        super().append(item)
        self.auditor.see(*item)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.lists(moments, max_size=25), ends)
def test_no_sequence_of_words_moves_a_servo_too_far_too_fast_or_when_it_must_be_limp(said, end):
    """Auditor: every goal on the wire and every step of every shaft, beside limits and stops."""
    robot = Robot(stops=[(4.0, end), (4.5, "soft")])
    auditor = Auditor(robot.face.servos, 1.0 / RATE_HZ)
    auditor.watch(robot.face.chain)
    robot.face.written = Tap(auditor)
    is_off, off_s, jogged = set(), [], []

    def play(word):
        answer = robot.say(word)
        if "asked" in answer and answer["asked"] != "reboot":
            (is_off.add if answer["asked"] == "off" else is_off.discard)(answer["servo"])

    def look():
        off_s.append((robot.face.clock.now(), frozenset(is_off)))
        jogged.append((robot.face.clock.now(), robot.bridge.jogged))
        if robot.face.clock.now() > 4.0:
            auditor.note_stop(4.0, StopLevel(end))

    at = {}
    for n, (moment_s, word) in enumerate(said):
        at[moment_s + n * 1e-6] = lambda word=word: play(word)
    for tick in range(round(4.4 * RATE_HZ)):
        at[tick / RATE_HZ + 1e-3] = look
    report = robot.live(60.0, at)

    assert report.complete
    counts = {
        name: getattr(auditor, name)
        for name in (
            *("goals_outside", "steps_too_long", "too_fast", "moved_outside"),
            *("armed_wrongly", "armed_late"),
        )
    }
    assert counts == dict.fromkeys(counts, 0)
    assert auditor.goals > 0
    names = [joint.name for joint in robot.face.joints]
    for time_s, torque, _ in robot.seen:
        before = [off for t, off in off_s if time_s - 0.2 < t <= time_s]
        for name in frozenset.intersection(*before) if before and time_s > 0.3 else ():
            assert not torque[names.index(name)]
    steps = np.abs(np.diff([deg for _, deg in robot.sent_deg], axis=0))
    for (time_s, _), step in zip(robot.sent_deg[1:], steps, strict=True):
        held = [set(each) for t, each in jogged if time_s - 0.1 < t <= time_s + 0.05]
        for name in set.intersection(*held) if held else ():
            assert step[names.index(name)] <= STEP_DEG
