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


def test_an_encoder_that_flickers_does_not_hide_a_jam():
    step_deg = 360.0 / 4096.0
    assert jaw_alone(place=lambda n, _: 2.0 + step_deg * (n % 2))


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
