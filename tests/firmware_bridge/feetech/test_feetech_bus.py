"""A bus of Feetech servos: nothing jumps, nothing holds unasked, and what goes wrong is said."""

import itertools

import numpy as np
import pytest
from feetech_chain import RATE, four_servos, wired
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_bridge.bus import HardwareError
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.mounting import mounted_servos as mounted_dynamixels
from firmware_bridge.errors import PortGone, ServoError
from firmware_bridge.feetech.bus import FeetechBus, budget
from firmware_bridge.feetech.codec import Instruction, packets_in
from firmware_bridge.feetech.control_table import servo_models
from firmware_bridge.feetech.line import Line
from firmware_bridge.feetech.mounting import MountedServo
from firmware_bridge.feetech.simulator import ChainFault, SimulatedChain
from firmware_bridge.feetech.torque import LineRelease
from firmware_bridge.joints import Joint
from firmware_bridge.simulator.chain import chain_for as dynamixel_chain
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.settings.settings import load_shipped_face

N = 4
TICK_S = 0.01


def run(on, seconds, goal_deg=None):
    """Ticks as the bridge makes them; the last health."""
    health = None
    for _ in range(round(seconds / TICK_S)):
        if goal_deg is not None:
            on.bus.write_positions(np.full(N, goal_deg))
        feedback = on.bus.feedback()
        health = on.bus.look_after()
        on.clock.advance(TICK_S)
    return feedback, health


def enabled(on):
    for index in range(N):
        assert on.bus.enable_torque(index) == ""


def writes(frames):
    """Every write on the wire as (id, address, data); a sync write is one for each servo."""
    for frame, _ in packets_in(b"".join(frames)):
        if frame is None:
            continue
        parameters = frame.data
        if frame.error == Instruction.WRITE:
            yield frame.servo_id, parameters[0], parameters[1:]
        elif frame.error == Instruction.SYNC_WRITE:
            address, size = parameters[:2]
            for block in _blocks(parameters[2:], size + 1):
                yield block[0], address, block[1:]


def _blocks(data, size):
    return [data[at : at + size] for at in range(0, len(data), size)]


ACTS = st.sampled_from(["enable", "disable", "goal", "limp", "reboot", "keep", "tick", "reopen"])


@settings(max_examples=40, deadline=None)
@given(
    acts=st.lists(st.tuples(ACTS, st.integers(0, N - 1), st.floats(-5, 5)), max_size=25),
    stiff=st.booleans(),
    faults=st.lists(
        st.tuples(
            st.sampled_from(["lost", "spoilt", "silence", "brown-out", "overload"]),
            st.floats(0.1, 3.0),
            st.integers(0, N - 1),
        ),
        max_size=4,
    ),
    model=st.sampled_from(["STS3215", "SCS0009"]),
)
def test_nothing_ever_writes_more_than_0_or_1_to_torque_nor_a_goal_to_a_limp_servo(
    acts, stiff, faults, model
):
    faults = [ChainFault(kind=kind, at_s=at, servo=n) for kind, at, n in faults]
    on = wired(four_servos(model), strict=False, wakes_up_stiff=stiff, faults=faults)
    wanted = set(range(N)) if stiff else set()
    with on.bus as bus:
        for act, index, value in acts:
            before = len(on.chain.changes)
            if act == "enable":
                wanted |= {index}
                bus.enable_torque(index)
            elif act == "keep":
                bus.keep_torque(index)
            elif act == "disable":
                bus.disable_torque(index)
            elif act == "reboot":
                bus.reboot(index)
            elif act == "goal":
                bus.write_positions(np.full(N, value))
            elif act == "limp":
                bus.disable_all()
            elif act == "reopen":
                bus.reopen()
            else:
                run(on, 0.2)
            stiff_now = {change.servo_id - 1 for change in on.chain.changes if change.torque}
            assert stiff or stiff_now <= wanted, (act, list(on.chain.changes)[before:])
    torques = {
        data[40 - address]
        for _, address, data in writes(on.frames)
        if address <= 40 < address + len(data)
    }
    assert torques <= {0, 1}


def test_a_servo_that_gets_torque_stays_where_it_stands_slow_and_weak_at_first():
    on = wired()
    on.chain.servos[0].stand_at(2100)
    on.chain.servos[0]["goal_position"] = 1900
    with on.bus as bus:
        on.frames.clear()
        assert bus.enable_torque(0) == ""
        assert bus.torque.as_json()[0] is True
        order = [address for servo_id, address, _ in writes(on.frames) if servo_id == 1]
        servo = on.chain.servos[0]

        assert [each for each, _ in itertools.groupby(order)] == [41, 48, 46, 42, 40]
        assert (servo["goal_position"], servo.place) == (2100, 2100)
        assert servo["torque_limit"] == 300
        assert servo["goal_speed"] == pytest.approx(60.0 * 4096 / 360, abs=1.0)
        assert not bus.at_full_strength
        run(on, 1.2)
        assert bus.at_full_strength
        assert servo["torque_limit"] == 999
        assert servo["goal_speed"] == pytest.approx(260.0 * 1.05 * 4096 / 360, abs=1.0)
        assert servo.place == 2100


@pytest.mark.parametrize("phase", [0x0C, 0x08])
def test_speeds_are_in_the_unit_that_the_servo_is_set_to(phase):
    on = wired(set_up=lambda chain: chain.servos[1].__setitem__("phase", phase))
    with on.bus as bus:
        assert bus.enable_torque(1) == ""
        speed = on.chain.servos[1]["goal_speed"]

    assert speed == {0x0C: 683, 0x08: 14}[phase]


@pytest.mark.parametrize("register", ["goal_speed", "torque_limit"])
def test_a_servo_that_does_not_keep_the_bounds_of_its_start_gets_no_torque(register, monkeypatch):
    on = wired()
    servo = on.chain.servos[0]
    write, at = type(servo).write, servo.dialect.registers[register].address
    monkeypatch.setattr(
        type(servo), "write", lambda to, address, data: address == at or write(to, address, data)
    )
    with on.bus as bus:
        assert bus.enable_torque(0) == "does not take its slow start"
        assert not servo["torque_enable"]


def test_a_servo_that_does_not_show_its_torque_is_switched_off_again(monkeypatch):
    on = wired()
    servo, torque_enable = on.chain.servos[0], 40
    read = type(servo).read

    def limp_by_its_word(of, address, size):
        return b"\0" if (address, size) == (torque_enable, 1) else read(of, address, size)

    with on.bus as bus:
        monkeypatch.setattr(type(servo), "read", limp_by_its_word)
        assert bus.enable_torque(0) == "does not switch its torque on"
        assert any(change.torque for change in on.chain.changes)
        assert not servo["torque_enable"]


def test_servos_come_on_one_after_another_for_the_sake_of_their_supply():
    on = wired()
    with on.bus:
        enabled(on)
        on_s = {}
        for change in on.chain.changes:
            on_s.setdefault(change.servo_id, change.time_s)

    assert len(on_s) == N
    assert (np.diff(list(on_s.values())) >= 0.01).all()


def test_a_goal_to_a_limp_servo_is_kept_for_later():
    """A goal on the wire would switch its torque on."""
    on = wired()
    with on.bus as bus:
        assert bus.enable_torque(2) == ""
        bus.write_positions(np.array([1.0, 2.0, 3.0, np.nan]))
        readings = bus.read()
        sent = [servo_id for servo_id, address, _ in writes(on.frames) if address == 42]

    assert set(sent) == {3}
    assert readings.torque.tolist() == [False, False, True, False]
    np.testing.assert_allclose(readings.goals_deg, [1.0, 2.0, 3.0, 0.0], atol=0.05)


def test_servos_that_wake_up_stiff_are_told_of_and_held_where_they_stand_before_anything():
    on = wired(wakes_up_stiff=True)
    with on.bus as bus:
        remarks = bus.remarks()
        assert [f"servo {s.joint.name!r}" in r for s, r in zip(on.servos, remarks, strict=True)]
        assert all("its torque was on before the start" in remark for remark in remarks)
        enabled(on)
        assert {change.goal for change in on.chain.changes} == {2048}
    assert not any(servo["torque_enable"] for servo in on.chain.servos)


def test_a_servo_that_a_stranger_switched_on_gets_no_goals():
    on = wired()
    with on.bus as bus:
        on.chain.servos[0].write(40, b"\1")
        run(on, 1.0, 5.0)
        assert bus.torque.as_json() == [True, False, False, False]

    assert not [servo_id for servo_id, address, _ in writes(on.frames) if address == 42]


def test_why_a_servo_is_not_let_go_is_said_as_it_is():
    on = wired(wakes_up_stiff=True)
    with on.bus:
        pass
    on.chain.servos[0].write(40, b"\1")
    release = LineRelease(on.open(), (RATE,))

    assert release.ask(1) == "kept its torque"
    assert release.ask(1) == ""
    assert release.ask(99) == "did not answer"


def test_a_servo_that_says_nothing_is_not_said_to_be_kept():
    on = wired(wakes_up_stiff=True)
    with on.bus as bus:
        on.chain.servos[0]["id"] = 77
        assert not bus.keep_torque(0)
        assert bus.keep_torque(1)


def test_a_servo_that_is_kept_stays_where_it_stands_and_gets_goals():
    on = wired(wakes_up_stiff=True, set_up=lambda chain: chain.servos[0].stand_at(2100))
    with on.bus as bus:
        assert bus.keep_torque(0)
        assert on.chain.servos[0]["goal_position"] == on.chain.servos[0].place == 2100
        run(on, 1.0, 1.0)
        assert bus.read().positions_deg[0] == pytest.approx(1.0, abs=0.2)


def test_after_a_brown_out_that_brings_torque_back_a_servo_is_let_go_and_starts_slowly_again():
    fault = ChainFault(kind="brown-out", at_s=3.0, servo=1)
    on = wired(wakes_up_stiff=True, faults=[fault])
    with on.bus as bus:
        enabled(on)
        run(on, 2.0, 2.0)
        assert bus.at_full_strength
        run(on, 2.0, 2.0)
        changes = [each for each in on.chain.changes if each.servo_id == 2 and each.time_s > 3.0]

        assert changes[-1].torque == 0
        assert bus.read().torque[1] == 0
        assert bus.enable_torque(1) == ""
        assert on.chain.servos[1]["torque_limit"] == 300


@pytest.mark.parametrize("model", ["STS3215", "SCS0009"])
def test_a_servo_that_protects_itself_is_told_of_until_it_is_restarted(model):
    fault = ChainFault(kind="jam", at_s=2.0, servo=3, lasts_s=4.0)
    on = wired(four_servos(model), faults=[fault])
    with on.bus as bus:
        enabled(on)
        run(on, 1.5, 0.0)
        _, health = run(on, 3.5, 4.0)
        assert health.hardware_errors.tolist() == [0, 0, 0, HardwareError.OVERLOAD]
        assert bus.disable_torque(3)
        _, health = run(on, 3.0)
        assert health.hardware_errors[3] == HardwareError.OVERLOAD
        bus.reboot(3)
        _, health = run(on, 0.1)
        assert not health.hardware_errors.any()
        assert bus.enable_torque(3) == ""


def test_what_servos_measure_is_read_with_every_tick():
    on = wired()
    with on.bus:
        enabled(on)
        run(on, 1.5, 0.0)  # full strength
        on.chain.motors.temperature[2] = 61.0
        on.chain.motors.load[0] = 0.4
        feedback, health = run(on, 0.2, 0.0)

    assert health.temperature_degc.tolist() == pytest.approx([25, 25, 61, 25], abs=1.0)
    assert health.room_degc[2] == pytest.approx(9.0, abs=1.0)
    assert health.voltage_v == pytest.approx(np.full(N, 7.4), abs=0.2)
    assert feedback.effort[0] == pytest.approx(0.4, abs=0.01)
    assert health.current_ma[0] == pytest.approx(0.4 * 2500, rel=0.02)


def test_one_who_is_silent_costs_only_its_own_samples_and_comes_back():
    fault = ChainFault(kind="silence", at_s=1.0, servo=0, lasts_s=1.0)
    on = wired(faults=[fault])
    with on.bus:
        enabled(on)
        run(on, 1.3, 0.0)
        feedback, health = run(on, 0.3, 0.0)
        assert (feedback.age_s > 0.0).tolist() == [True, False, False, False]
        assert health.silent_s[0] > 0.3
        assert health.silent_s[1:].max() < 0.02
        feedback, health = run(on, 1.5, 0.0)
        assert not feedback.age_s.any()
        assert health.n_unanswered[0] > 0
        assert not health.n_unanswered[1:].any()


def test_a_servo_that_misses_its_first_read_stands_where_it_was_found_as_it_got_torque():
    silences = [
        ChainFault(kind="silence", at_s=at_s, servo=1, lasts_s=lasts_s)
        for at_s, lasts_s in ((0.0, 3.0), (4.0, 1.0))
    ]
    on = wired(strict=False, faults=silences)
    on.chain.servos[1].stand_at(2200)
    with on.bus as bus:
        on.clock.sleep_until(3.0)
        assert bus.enable_torque(1) == ""
        on.clock.sleep_until(4.0)
        feedback, health = run(on, TICK_S)

    assert feedback.age_s[1] > 0.0
    assert feedback.positions_deg[1] == pytest.approx((2200 - 2048) * 360 / 4096)
    assert np.isnan([health.voltage_v[1], health.temperature_degc[1]]).all()


@pytest.mark.parametrize("is_kept", [False, True])
def test_a_servo_that_misses_an_answer_before_its_first_goal_begins_where_it_stands(is_kept):
    """Goals since then are approached from the last one; there is none, or one of long ago."""
    silence = ChainFault(kind="silence", at_s=2.0, servo=0, lasts_s=0.05)
    on = wired(faults=[silence], period_s=0.02)
    with on.bus as bus:
        enabled(on)
        if is_kept:
            run(on, 0.3, 4.0)
            assert bus.disable_torque(0)
            on.chain.servos[0].stand_at(on.chain.servos[0].place + 150)
            assert bus.enable_torque(0) == ""
        place = on.chain.servos[0].place
        while not bus.feedback().age_s[0]:
            on.clock.advance(TICK_S)
        on.frames.clear()
        run(on, 0.1, 0.0)
        goals = [
            int.from_bytes(data[:2], "little")
            for servo_id, address, data in writes(on.frames)
            if (servo_id, address) == (1, 42)
        ]

    reach_deg = 0.02 * on.servos[0].joint.max_speed_deg_s
    assert goals
    assert abs(goals[0] - place) <= 1 + reach_deg * on.servos[0].model.pulses_per_deg


@pytest.mark.parametrize("kind", ["lost", "spoilt"])
def test_answers_that_are_lost_or_spoilt_are_old_and_never_wrong(kind):
    on = wired(faults=[ChainFault(kind=kind, at_s=1.0, lasts_s=0.5)])
    with on.bus as bus:
        enabled(on)
        ages = []
        for _ in range(150):
            bus.write_positions(np.full(N, 1.0))
            feedback = bus.feedback()
            bus.look_after()
            on.clock.advance(TICK_S)
            ages.append(feedback.age_s.max())
            assert (np.abs(feedback.positions_deg) < 1.2).all()
    assert max(ages) > 0.0
    assert ages[-1] == 0.0
    assert on.chain.n_spoken_over == 0


class LateTransport(MemoryTransport):
    """What servos answer from a moment on arrives so much later."""

    late_s = 0.0

    def read(self, deadline_s):
        data = super().read(deadline_s)
        if data and self.late_s:
            self.held = (self.clock.now() + self.late_s, data)
            self.late_s = 0.0
            self.clock.sleep_until(deadline_s)
            return b""
        return self._with_held(data)

    def discard_input(self):
        return self._with_held(super().discard_input())

    def _with_held(self, data):
        due_s, held = getattr(self, "held", (0.0, b""))
        if held and due_s <= self.clock.now():
            self.held = (0.0, b"")
            return held + data
        return data


def test_a_late_answer_is_not_taken_for_that_to_the_next_question():
    on = wired()
    transport = LateTransport(on.chain, on.clock, RATE)
    line = Line(transport)
    assert line.read(1, 5, 1).data == b"\1"
    transport.late_s = 0.03
    assert line.read(1, 5, 1) is None

    assert line.read(1, 40, 1).data == b"\0"
    assert line.read(1, 40, 1).data == b"\0"


def test_torque_off_needs_the_word_of_every_servo():
    fault = ChainFault(kind="silence", at_s=1.0, servo=2, lasts_s=5.0)
    on = wired(faults=[fault])
    with on.bus as bus:
        enabled(on)
        run(on, 1.2, 0.0)

        assert bus.disable_all().tolist() == [True, True, False, True]
        assert not bus.disable_torque(2)
        on.clock.advance(6.0)
        assert bus.disable_torque(2)


def test_a_plug_that_is_pulled_is_noticed_and_the_bus_comes_back():
    on = wired(faults=[ChainFault(kind="unplug", at_s=1.0, lasts_s=0.5)])
    with on.bus as bus:
        enabled(on)
        with pytest.raises(PortGone):
            run(on, 1.5, 0.0)
        on.clock.advance(1.0)
        bus.reopen()
        assert bus.keep_torque(0)
        assert not bus.feedback().age_s.any()


def refusal(bus):
    with pytest.raises(ServoError) as error, bus:
        pass
    return str(error.value)


def test_scs_taken_for_sts_is_refused_in_a_line_a_servo():
    scs = four_servos("SCS0009")
    on = wired(scs)
    lines = refusal(FeetechBus(four_servos(), on.open)).splitlines()

    assert len(lines) == N + 1
    assert lines[0] == (
        f"servo {scs[0].joint.name!r} (id 1) is not the STS3215 of the YAML but an SCS0009; "
        "correct the YAML"
    )
    assert not any(address > 4 for _, address, _ in writes(on.frames))


def test_two_servos_of_one_id_are_refused():
    servo, twin = servo_models()["STS3215"], four_servos()[0]
    chain, clock = SimulatedChain([servo, servo], [1, 1]), ManualClock()
    chain.servos[1].stand_at(1000)
    bus = FeetechBus([twin], lambda: MemoryTransport(chain, clock, RATE))

    assert refusal(bus).splitlines()[0] == (
        f"servo {twin.joint.name!r} (id 1) has answers that are spoilt: two servos may have this "
        f"id; connect one of them alone and run `lipservo setup-servos {twin.joint.name}`"
    )


def test_dynamixels_named_feetech_and_the_reverse_are_refused_in_one_line():
    face, clock = load_shipped_face("face_four"), ManualClock()
    dynamixels = mounted_dynamixels(face.wiring)
    chain = dynamixel_chain(dynamixels, RATE)
    bus = FeetechBus(four_servos(), lambda: MemoryTransport(chain, clock, RATE))
    assert refusal(bus) == (
        "no servo answers as `kind: feetech`, but as `kind: dynamixel`; correct the YAML"
    )
    assert refusal(DynamixelBus(dynamixels, wired().open)) == (
        "no servo answers as `kind: dynamixel`, but as `kind: feetech`; correct the YAML"
    )


def test_servos_at_another_rate_do_not_answer():
    on = wired(set_up=lambda chain: [s.__setitem__("baud_rate", 4) for s in chain.servos])

    assert refusal(on.bus).splitlines()[0].endswith("check its power, cable and baud rate")


@pytest.mark.parametrize(
    ("register", "value", "words"),
    [
        ("operating_mode", 1, "is in operating mode 1, not 0"),
        ("phase", 0x1C, "counts many turns (phase 28)"),
        ("max_position_limit", 2050, "has limits"),
    ],
)
def test_a_servo_that_is_set_up_otherwise_gets_no_torque(register, value, words):
    on = wired(set_up=lambda chain: chain.servos[0].__setitem__(register, value))

    assert words in refusal(on.bus)
    assert "run `lipservo setup-servos`" in refusal(on.bus)


def test_a_servo_outside_its_own_range_must_be_moved_by_hand():
    on = wired(set_up=lambda chain: chain.servos[0].stand_at(3000))
    with on.bus as bus:
        assert [bool(bus.obstacle(index)) for index in range(N)] == [True, False, False, False]
        assert "outside its own range; move it into" in bus.enable_torque(0)
        assert not bus.read().torque.any()


def many(model, n):
    return [
        MountedServo(Joint(f"j{k}", k + 1, -5.0, 5.0, 100.0), servo_models()[model])
        for k in range(n)
    ]


def test_a_bus_that_is_too_slow_says_what_would_help():
    assert budget(many("STS3215", 16), 1_000_000, 100.0) is None
    assert "only" in budget(many("STS3215", 16), 115_200, 100.0)
    assert "set 1,000,000 baud" in budget(many("STS3215", 8), 115_200, 100.0)
    assert "use fewer servos or a lower rate" in budget(many("SCS0009", 16), 1_000_000, 100.0)
