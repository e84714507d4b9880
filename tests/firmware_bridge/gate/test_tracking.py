"""Servos that do not follow, at the motion of the bundled clip on servos simulated to the byte."""

import gzip
import json

import numpy as np
import pytest
from places import DATA

from calibration.simulated.servos import SimulatedServos
from firmware_bridge.bus import Feedback
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.gate.limits import Limiter
from firmware_bridge.gate.tracking import TrackingMonitor, TrackingRule
from firmware_bridge.joints import Joint
from firmware_bridge.simulator.chain import chain_for
from firmware_bridge.simulator.faults import Fault
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.settings.settings import load_shipped_face

CLIP = DATA / "traces" / "clip.jsonl.gz"
FACE = load_shipped_face("face_sim")
JAW = list(FACE.servos).index("jaw")
#: Servos just enabled need not follow, as in `ServoSupervision`.
SUSPENDED_S = 2.0


def clip_deg(rate_hz, strength=1.0):
    """Times from 0 and the goals of the clip, (n, 10)."""
    ticks = [json.loads(line) for line in gzip.decompress(CLIP.read_bytes()).splitlines()[1:-1]]
    recorded_s = np.array([tick["sound_s"] for tick in ticks])
    recorded_deg = np.array([tick["sent_deg"] for tick in ticks])
    times_s = np.arange(0.0, recorded_s[-1], 1.0 / rate_hz)
    goals_deg = [np.interp(times_s, recorded_s, column) for column in recorded_deg.T]
    return times_s, strength * np.stack(goals_deg, axis=1)


def feedback(time_s, positions_deg, age_s=0.0):
    n = len(positions_deg)
    return Feedback(
        time_s, np.asarray(positions_deg), np.zeros(n), np.zeros(n, np.uint8), np.full(n, age_s)
    )


def speak(rate_hz=30.0, strength=1.0, faults=(), capped=True):
    """When each servo was found not to follow first, and why, by name; the clip from 2 s on."""
    servos, clock = mounted_servos(FACE.wiring), ManualClock()
    chain = chain_for(servos, FACE.bus.baud_rate, faults=faults)
    if not capped:
        for simulated in chain.servos:
            simulated["operating_mode"] = 3
        servos = [type(s)(s.joint, s.model, s.sign, s.zero_offset_deg) for s in servos]
    monitor = TrackingMonitor(FACE.joints(), TrackingRule())
    found = {}
    bus = DynamixelBus(servos, lambda: MemoryTransport(chain, clock, FACE.bus.baud_rate))
    with bus:
        for index in range(len(servos)):
            assert bus.enable_torque(index) == ""
            monitor.suspend_until(index, clock.now() + SUSPENDED_S)
        times_s, goals_deg = clip_deg(rate_hz, strength)
        start_s = clock.now()
        for time_s, goal_deg in zip(times_s, goals_deg, strict=True):
            clock.sleep_until(start_s + time_s)
            bus.write_positions(goal_deg)
            behind = monitor.behind(goal_deg, bus.feedback())
            bus.look_after()
            for index in np.flatnonzero(behind).tolist():
                name = FACE.joints()[index].name
                found.setdefault(name, (clock.now() - start_s, monitor.reason(index)))
    return found


@pytest.mark.parametrize("jammed_s", [0.0, 2.6, 4.1])
def test_a_jaw_that_jams_anywhere_is_noticed_within_five_seconds_of_speech(jammed_s):
    found = speak(faults=[Fault("jam", servos=(JAW,), at_s=(0.3 + jammed_s,))])

    assert set(found) == {"jaw"}
    noticed_s, why = found["jaw"]
    assert noticed_s - max(jammed_s, SUSPENDED_S) < 5.0
    assert "does not move: its goals travelled" in why


@pytest.mark.parametrize(
    ("rate_hz", "strength"), [(30.0, 1.0), (50.0, 1.0), (100.0, 1.0), (30.0, 0.3)]
)
def test_speech_on_good_servos_raises_no_alarm(rate_hz, strength):
    assert speak(rate_hz, strength) == {}


def test_weak_servos_under_half_their_load_raise_no_alarm():
    assert speak(faults=[Fault("load", at_s=(0.0,), amount=0.5)], capped=False) == {}
    # A fifth of the stall torque is all that a lip may pull; half of that is load.
    assert speak(faults=[Fault("load", at_s=(0.0,), amount=0.1)]) == {}


@pytest.mark.parametrize("strength", [1.0, 0.3])
@pytest.mark.parametrize("rate_hz", [30.0, 50.0, 100.0])
@pytest.mark.parametrize("seed", range(2))
def test_late_servos_with_play_before_their_encoder_raise_no_alarm(rate_hz, strength, seed):
    """40 to 90 ms late, 250 to 500 deg/s, and 1.4 deg of play that their encoder feels."""
    times_s, goals_deg = clip_deg(rate_hz, strength)
    places_deg = SimulatedServos.drawn(goals_deg.shape[1], seed).encoders_deg(goals_deg, rate_hz)
    monitor = TrackingMonitor(FACE.joints(), TrackingRule())
    place_deg = places_deg[0]
    for time_s, goal_deg, shaft_deg in zip(times_s, goals_deg, places_deg, strict=True):
        place_deg = np.clip(place_deg, shaft_deg - 0.7, shaft_deg + 0.7)
        assert not monitor.behind(goal_deg, feedback(time_s, place_deg)).any()


def jaw_alone(**places):
    """Whether a jaw is behind in the end whose goals are the clip's."""
    times_s, goals_deg = clip_deg(100.0)
    monitor = TrackingMonitor([FACE.joints()[JAW]], TrackingRule())
    behind = False
    for n, (time_s, goal_deg) in enumerate(zip(times_s, goals_deg[:, JAW], strict=True)):
        said = places["place"](n, goal_deg)
        if "suspend_until_s" in places and n == 0:
            monitor.suspend_until(0, places["suspend_until_s"])
        age_s = places.get("age_s", lambda _: 0.0)(n)
        behind |= bool(monitor.behind(np.array([goal_deg]), feedback(time_s, [said], age_s))[0])
    return behind


@pytest.mark.parametrize("n_steps", [1, 2])
def test_an_encoder_that_flickers_does_not_hide_a_jam(n_steps):
    flicker_deg = n_steps * 360.0 / 4096.0
    assert jaw_alone(place=lambda n, _: 2.0 + flicker_deg * (n % 2))


def test_what_was_not_heard_counts_for_nothing():
    assert not jaw_alone(place=lambda *_: float("nan"), age_s=lambda _: np.inf)
    assert not jaw_alone(place=lambda *_: 2.0, age_s=lambda _: 0.1)

    # Every fourth answer is enough to notice, and to be content.
    def seldom(n):
        return 0.0 if n % 4 == 0 else 0.02

    assert jaw_alone(place=lambda *_: 2.0, age_s=seldom)
    assert not jaw_alone(place=lambda _, goal_deg: goal_deg, age_s=seldom)


def test_servos_just_enabled_need_not_follow():
    assert not jaw_alone(place=lambda *_: 2.0, suspend_until_s=8.0)


def test_a_servo_that_is_asked_for_nothing_may_stand_still():
    monitor = TrackingMonitor([Joint("jaw", 1, -2.0, 25.0, 300.0)], TrackingRule())
    for tick in range(3000):
        # Rest, with the half degree that breathing or a rounding filter may ask for.
        goal_deg = np.array([0.5 * np.sin(tick * 0.1)])
        assert not monitor.behind(goal_deg, feedback(tick * 0.01, [0.0])).any()


@pytest.mark.parametrize(
    ("low_deg", "high_deg", "allowed_deg"), [(-2, 25, 9.0), (-40, 35, 15.0), (-1, 1, 3.0)]
)
def test_the_error_that_is_allowed_follows_from_the_range(low_deg, high_deg, allowed_deg):
    joint = Joint("jaw", 1, low_deg, high_deg, 300.0)

    assert TrackingRule().allowed_deg(joint) == allowed_deg
    assert TrackingRule(error_deg=4.0).allowed_deg(joint) == 4.0


ONE_JOINT = [Joint("jaw", 1, -40.0, 40.0, 300.0)]


@pytest.mark.parametrize(
    ("lag_deg", "age_s", "behind"), [(14.9, 0.0, False), (15.1, 0.0, True), (90.0, 1.0, False)]
)
def test_only_a_lasting_error_that_was_heard_counts(lag_deg, age_s, behind):
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule(error_deg=15.0, after_s=0.5))
    found = []
    for tick in range(60):
        age = np.array([age_s])
        feedback = Feedback(tick * 0.01, np.zeros(1), np.zeros(1), np.zeros(1, np.uint8), age)
        found.append(bool(monitor.behind(np.array([lag_deg]), feedback)[0]))

    assert found == [behind and tick > 50 for tick in range(60)]


def test_quick_motion_that_crosses_its_goal_is_no_failure_to_follow():
    """25 deg to and fro, always 30 ms late: up to 20 deg behind, but never for half a second."""
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule())
    for tick in range(1000):
        time_s = tick * 0.01
        goal, place = (25.0 * np.sin(2 * np.pi * 4.0 * s) for s in (time_s, time_s - 0.03))
        heard = Feedback(time_s, np.array([place]), np.zeros(1), np.zeros(1, np.uint8), np.zeros(1))
        assert not monitor.behind(np.array([goal]), heard).any()


HEAD = load_shipped_face("face_head")
HEAD_JAW = list(HEAD.servos).index("jaw")


def busy_ticks(seed, seconds):
    """Ticks of a busy computer: runs of 10 ms, 33 ms, anything to 1 s; and the speech at each.

    Speech: each joint within its range, 3 Hz and less, of another phase and size for each.
    """
    generator, joints = np.random.default_rng(seed), HEAD.joints()
    gaps_s = []
    while sum(gaps_s) < seconds:
        most_s = generator.choice([0.01, 0.034, 0.3, 1.0])
        gaps_s += generator.uniform(0.01, max(most_s, 0.011), generator.integers(1, 30)).tolist()
    low_deg, high_deg = (np.array([getattr(j, f"{e}_deg") for j in joints]) for e in ("min", "max"))
    hz = generator.uniform(0.5, 3.0, len(joints))
    phase = generator.uniform(0.0, 2.0 * np.pi, len(joints))
    size = generator.uniform(0.3, 1.0, len(joints))
    for time_s in np.cumsum(gaps_s):
        share = 0.5 + 0.5 * size * np.sin(2.0 * np.pi * hz * time_s + phase)
        yield float(time_s), low_deg + share * (high_deg - low_deg)


def speak_on_a_busy_computer(seed, seconds=20.0, watchdog_s=0.1, jammed_s=None):
    """When each servo was found not to follow first, and why, by name: sixteen, to the byte."""
    servos, clock, joints = mounted_servos(HEAD.wiring), ManualClock(), HEAD.joints()
    chain = chain_for(servos, HEAD.bus.baud_rate)
    monitor, limiter = TrackingMonitor(joints, TrackingRule()), Limiter(joints, 1.0 / 30.0)
    found = {}

    def open_port():
        return MemoryTransport(chain, clock, HEAD.bus.baud_rate)

    with DynamixelBus(servos, open_port, watchdog_s=watchdog_s) as bus:
        limiter.start_from(bus.read().positions_deg, clock.now())
        for index in range(len(servos)):
            assert bus.enable_torque(index) == ""
            monitor.suspend_until(index, clock.now() + SUSPENDED_S)
        start_s = clock.now()
        for time_s, wanted_deg in busy_ticks(seed, seconds):
            clock.sleep_until(start_s + time_s)
            if jammed_s is not None and time_s >= jammed_s:
                chain.motors.jammed[HEAD_JAW] = True
            sent_deg = limiter.apply(wanted_deg, clock.now()).positions_deg
            bus.write_positions(sent_deg)
            behind = monitor.behind(sent_deg, bus.feedback())
            bus.look_after()
            for index in np.flatnonzero(behind).tolist():
                found.setdefault(joints[index].name, (time_s, monitor.reason(index)))
    return found


@pytest.mark.parametrize("watchdog_s", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_servos_that_follow_are_accused_by_no_computer_however_busy(seed, watchdog_s):
    """Found in daemons at rest: with ticks .3 s apart an eyelid was 25 degrees off for .5 s."""
    assert speak_on_a_busy_computer(seed, watchdog_s=watchdog_s) == {}


@pytest.mark.parametrize("seed", range(2))
def test_a_jam_is_named_on_a_busy_computer_and_nobody_else(seed):
    found = speak_on_a_busy_computer(seed, seconds=30.0, jammed_s=4.0)

    assert set(found) == {"jaw"}
    assert "jammed or weak" in found["jaw"][1]


def moves_at_once(gaps_s, wanted_deg, after_s=0.5):
    """In which ticks a joint was found behind that reaches each goal within 10 ms, but no sooner.

    It is read just after a goal was written, so that it is where the goal before sent it.
    """
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule(after_s=after_s))
    time_s, place_deg, found = 0.0, wanted_deg[0], []
    for tick, (gap_s, goal_deg) in enumerate(zip(gaps_s, wanted_deg, strict=True)):
        time_s += gap_s
        if monitor.behind(np.array([goal_deg]), feedback(time_s, [place_deg]))[0]:
            found.append(tick)
        place_deg = goal_deg
    return found


def test_a_late_tick_is_compared_with_the_goal_of_the_tick_before():
    to_and_fro_deg = [20.0 * (-1.0) ** n for n in range(200)]

    assert moves_at_once([0.3] * 200, to_and_fro_deg) == []
    assert moves_at_once([0.033] * 200, to_and_fro_deg) == []


@pytest.mark.parametrize(
    ("gap_s", "ticks"), [(0.01, 50), (0.034, 15), (0.05, 10), (0.3, 10), (1.0, 10)]
)
def test_half_a_second_of_doubt_is_ten_ticks_at_least(gap_s, ticks):
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule())
    # It has followed before, and then does not any more.
    monitor.behind(np.zeros(1), feedback(100.0, [0.0]))
    monitor.behind(np.array([20.0]), feedback(100.01, [0.0]))
    found = [
        bool(monitor.behind(np.array([20.0]), feedback(100.01 + n * gap_s, [0.0]))[0])
        for n in range(1, 80)
    ]

    assert found.index(True) == pytest.approx(ticks, abs=1)
    assert all(found[found.index(True) :])


def test_a_tick_that_follows_ends_a_doubt_however_late_it_comes():
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule())
    for n in range(60):
        place_deg = 20.0 if n % 9 == 8 else 0.0
        assert not monitor.behind(np.array([20.0]), feedback(0.3 * n, [place_deg])).any()


def test_a_long_pause_counts_for_no_doubt_and_lengthens_no_suspension():
    """Stopped and limp for ten minutes, then started: a jam is found as soon as ever."""
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule())
    monitor.behind(np.zeros(1), feedback(1.0, [0.0]))
    monitor.suspend_until(0, 602.0)
    found = [
        600.0 + n * 0.01
        for n in range(400)
        if monitor.behind(np.array([20.0]), feedback(600.0 + n * 0.01, [0.0]))[0]
    ]

    assert found[0] == pytest.approx(602.5, abs=0.02)


def test_what_a_servo_did_not_travel_before_it_got_torque_is_not_held_against_it():
    """Its goals travelled while it was suspended; afterwards they rest, and so does it."""
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule())
    for n in range(400):
        goal_deg = 8.0 * np.sin(n * 0.2) if n < 201 else 0.0
        if n == 60:
            monitor.suspend_until(0, 2.0)
        found = monitor.behind(np.array([goal_deg]), feedback(n * 0.01, [0.0]))
        assert not found.any()


def test_a_jam_of_before_is_not_held_against_a_servo_that_was_enabled_in_one_late_tick():
    """It was given torque, and its two seconds to catch up passed without a tick."""
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule())
    found = [
        monitor.behind(np.array([8.0 * np.sin(n * 0.2)]), feedback(0.1 + n * 0.01, [0.0]))[0]
        for n in range(300)
    ]
    assert found[-1]
    monitor.suspend_until(0, 5.0)

    for n in range(20):
        assert not monitor.behind(np.zeros(1), feedback(5.1 + 0.3 * n, [0.0])).any()
