"""A face on a simulated Maestro: starts, stops and faults, judged by what goes to the servos."""

import json
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from dynamixel_chain import MemoryFace
from hobby_bus import on_maestro
from maestro_face import FACE, RATE_HZ, N, drive, last_us, put_together, say_nothing

from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.gate.limits import PreventRule
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.maestro.controller import MaestroController
from firmware_bridge.maestro.kind import BAUD_RATE
from firmware_bridge.maestro.simulator import PulseFault, Shaft, read_faults, serve
from firmware_bridge.pulse_bus import STAGGER_S, KeptPulses
from firmware_bridge.several_buses import SeveralBuses
from firmware_bridge.simulation_request import SimulationRequest
from firmware_bridge.stopping import ServoOrder, ServoSwitch, StopLevel


@pytest.mark.parametrize("model", ["micro6", "mini12", "mini24"])
@pytest.mark.parametrize("crc", [False, True])
@pytest.mark.parametrize("device", [None, 12])
def test_every_model_is_driven_to_its_goals(model, crc, device):
    face = put_together(model=model, crc=crc, device=device)
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)

        assert face.bridge.troubles == ()
        np.testing.assert_allclose(last_us(face), 1550.0, atol=1.0)
        assert not face.maestro.errors
        assert face.bus.remarks() == []
    assert last_us(face) == [0.0] * N


def test_servos_come_on_one_after_another_where_they_were_and_go_slowly(tmp_path):
    kept = tmp_path / "pulses.json"
    kept.write_text(json.dumps({"pulses_us": {str(n): 1600.0 for n in range(N)}}))
    face = put_together(kept=kept, may_jump=False)
    for channel in face.maestro.channels:
        channel.shaft = Shaft(1600.0)
    with face.bus:
        face.bridge.start()
        drive(face, 6.0, goal_deg=0.0)
        pulses = list(face.maestro.pulses)
    on = {each.channel: each for each in reversed(pulses)}
    times = sorted(each.time_s for each in on.values())

    assert [each.pulse_us for each in on.values()] == [1600.0] * N
    assert (np.diff(times) >= 0.24).all()
    for number in range(N):
        one = [each for each in pulses if each.channel == number]
        steps = np.abs(np.diff([each.pulse_us for each in one]))
        assert steps.max() <= 600.0 / RATE_HZ + 1.0
        assert one[-1].pulse_us == 1500.0
    assert json.loads(kept.read_text())["pulses_us"] == {str(n): 1500.0 for n in range(N)}


def test_a_tick_is_one_write_and_no_pulse_is_said_to_be_sent_before_it():
    face = put_together(model="mini12")

    def said():
        return [each["sent_us"] for each in face.bridge.as_dict()["pulses"].values()]

    receive, heard = face.maestro.receive, []
    with face.bus:
        face.bridge.start()
        drive(face, 3.0, goal_deg=-5.0)
        note = heard.append
        face.maestro.receive = lambda data, *rest: (note((len(data), said())), receive(data, *rest))
        for goal_deg in np.linspace(-4.0, 10.0, 30):
            before = said()
            drive(face, 1.0 / RATE_HZ, goal_deg=goal_deg)
            assert said() != before
            assert heard[0] == (3 + 2 * N, before)
            heard.clear()
        face.maestro.receive = receive


@pytest.mark.parametrize("tolerant", [False, True])
def test_a_rule_between_joints_counts_with_a_servo_that_has_not_come_on_yet(tmp_path, tolerant):
    """Joint 0 may be 4 degrees above joint 1 at most; its turn comes first."""
    kept = tmp_path / "pulses.json"
    KeptPulses(kept).write(dict.fromkeys(range(N), 1500.0))
    rule = PreventRule((1.0, -1.0, *[0.0] * (N - 2)), 4.0, "they touch")
    face = put_together(kept=kept, may_jump=False, prevent=[rule], tolerant=tolerant)
    with face.bus:
        face.bridge.start()
        drive(face, 4.0, goal_deg=np.array([7.0, 7.0, *[0.0] * (N - 2)]))
        pulses = list(face.maestro.pulses)
    sent_us, highest_deg = [1500.0, 1500.0], 0.0
    for each in pulses:
        if each.channel < 2 and each.pulse_us:
            sent_us[each.channel] = each.pulse_us
            highest_deg = max(highest_deg, (sent_us[0] - sent_us[1]) / 10.0)

    assert 3.0 < highest_deg <= 4.0 + 1.3  # of one command the first channel is logged first
    assert sent_us == [1570.0, 1570.0] or sent_us == [1500.0, 1500.0]


def test_the_first_start_is_refused_until_a_person_allows_it(tmp_path):
    kept = tmp_path / "deeper" / "pulses.json"
    face = put_together(kept=kept, may_jump=False)
    with face.bus:
        assert "calibrate neutral --yes" in face.bus.enable_torque(0)
        drive(face, 0.5)
    assert not face.maestro.pulses

    face = put_together(kept=kept, may_jump=True)
    with face.bus:
        assert face.bus.enable_torque(0) == ""
        drive(face, 0.1)
    face = put_together(kept=kept, may_jump=False)
    with face.bus:
        assert face.bus.enable_torque(0) == ""


def test_the_voltage_of_an_input_is_no_pulse_that_allows_the_first_start(tmp_path):
    kept = tmp_path / "pulses.json"
    face = put_together(kept=kept, may_jump=False)
    face.maestro.channels[1].position = face.maestro.channels[1].target = 200
    with face.bus:
        assert "calibrate neutral --yes" in face.bus.enable_torque(1)
        assert not face.bus.keep_torque(1)
    assert not kept.exists()


def test_only_what_was_sent_is_filed_as_known(tmp_path):
    kept = tmp_path / "pulses.json"
    face = put_together(kept=kept)
    with face.bus:
        for index in range(N):
            assert face.bus.enable_torque(index) == ""
        face.clock.advance(1.2 * STAGGER_S)
        face.bus.write_positions(np.zeros(N))  # two have had their turn
        assert face.bus.torque.as_json() == [True, True, *[None] * (N - 2)]
    assert json.loads(kept.read_text())["pulses_us"] == {"0": 1500.0, "1": 1500.0}


def test_a_replug_keeps_the_pulses_that_the_maestro_kept():
    face = put_together()
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        n_pulses = len(face.maestro.pulses)
        face.bus.reopen()

        assert face.bus.torque.as_json() == [True] * N
        for index in range(N):  # at once, since none of them comes on
            assert face.bus.enable_torque(index) == ""
            assert face.bus.torque.as_json() == [True] * N
        for _ in range(200):
            face.clock.advance(0.02)
            face.bus.write_positions(np.full(N, -5.0))
        later_us = {n: [] for n in range(N)}
        for each in list(face.maestro.pulses)[n_pulses:]:
            later_us[each.channel].append(each.pulse_us)
        for pulses_us in later_us.values():
            assert min(pulses_us) > 0.0
            assert np.abs(np.diff([1550.0, *pulses_us])).max() <= 600.0 / RATE_HZ + 1.0
            assert pulses_us[-1] == 1450.0


def test_servos_that_are_kept_go_on_at_once_and_none_waits_for_its_turn():
    face = put_together()
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        n_pulses = len(face.maestro.pulses)

        assert all(face.bus.keep_torque(index) for index in range(N))
        assert face.bus.torque.as_json() == [True] * N
        drive(face, 0.5)
        assert all(each.pulse_us > 0.0 for each in list(face.maestro.pulses)[n_pulses:])


def test_a_servo_whose_pulses_ended_unseen_is_not_kept_and_gets_none_by_the_next_write():
    face = put_together(serial_timeout_s=0.5, port="/dev/x")
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        face.clock.advance(0.6)

        assert not any(face.bus.keep_torque(index) for index in range(N))
        face.bus.write_positions(np.zeros(N))
        assert last_us(face) == [0.0] * N


def test_a_bus_that_is_entered_again_files_its_pulses_to_the_last(tmp_path):
    kept = tmp_path / "pulses.json"
    face = put_together(kept=kept)
    for goal_deg in (0.0, 2.0):
        with face.bus:
            assert face.bus.enable_torque(0) == ""
            for _ in range(50):
                face.clock.advance(0.02)
                face.bus.write_positions(np.full(N, goal_deg))
            sent_us = last_us(face)[0]
        assert json.loads(kept.read_text())["pulses_us"]["0"] == sent_us
        assert "kept pulses" not in {thread.name for thread in threading.enumerate()}


def test_a_servo_found_with_a_pulse_keeps_it_until_it_is_started_or_let_go():
    face = put_together()
    face.maestro.receive(bytes.fromhex("84 00 20 32"), 0.0, BAUD_RATE)  # 1608 us
    face.maestro.receive(bytes.fromhex("84 01 20 32"), 0.0, BAUD_RATE)
    with face.bus:
        assert face.bus.enable_torque(2) == ""
        face.bus.write_positions(np.zeros(N))
        assert last_us(face)[:3] == [1608.0, 1608.0, 1500.0]
        assert face.bus.torque.as_json()[:2] == [True, True]
        assert face.bus.disable_torque(1)
        assert face.bus.torque.as_json()[:2] == [True, False]
    assert last_us(face) == [0.0] * N


def test_a_controller_that_still_sends_is_believed_before_the_file(tmp_path):
    kept = tmp_path / "pulses.json"
    KeptPulses(kept).write({0: 1200.0})
    face = put_together(kept=kept)
    face.maestro.receive(bytes.fromhex("84 00 20 32"), 0.0, BAUD_RATE)  # 1608 us
    with face.bus:
        goals_deg = face.bus.read().goals_deg

    assert goals_deg[0] == pytest.approx(10.4, abs=0.5)


def test_a_file_that_says_nothing_usable_is_no_file(tmp_path):
    kept = tmp_path / "pulses.json"
    for text in ("", "[]", '{"pulses_us": 3}', '{"pulses_us": {"a": 1}}'):
        kept.write_text(text)
        assert KeptPulses(kept).read() == {}


def test_the_wrong_serial_mode_is_refused_with_the_remedy():
    face = put_together(deaf=True)
    with pytest.raises(PortError, match=r"USB Dual Port.*lower.*command port"), face.bus:
        pass


def test_a_crc_that_only_one_side_uses_is_refused():
    for yaml_has, maestro_has in ((True, False), (False, True)):
        face = put_together(crc=yaml_has, really={"crc": maestro_has})
        with pytest.raises(PortError, match=r"bus\.crc"), face.bus:
            pass


def test_channels_that_the_model_has_not_are_refused():
    wiring = on_maestro(FACE)
    joints = (*wiring.joints[:-1], type(wiring.joints[0])("ear", 7, -1.0, 1.0, 100.0))
    with pytest.raises(ServoError, match="ear: a Maestro micro6 has channels 0 to 5"):
        MaestroController(type(wiring)(wiring.settings, joints, wiring.servos, 50.0), None)


def test_a_model_that_has_no_command_for_all_is_found_by_what_it_sends():
    face = put_together(model="mini12", really={"model": "micro6"})
    with face.bus:
        face.bridge.start()
        drive(face, 2.0)

        assert any("protocol error" in each for each in face.bus.remarks())
        assert last_us(face) == [0.0] * N


def test_after_a_brown_out_servos_come_back_one_after_another_where_they_were():
    """A Maestro that starts anew is another device on USB, so its port is lost first."""
    face = put_together(faults=[PulseFault(kind="brown-out", at_s=3.0)])
    with face.bus:
        face.bridge.start()
        drive(face, 8.0)
        pulses = [each for each in face.maestro.pulses if each.time_s > 3.0]

        assert face.bridge.troubles == ()
        np.testing.assert_allclose(last_us(face), 1550.0, atol=1.0)
        assert {each.pulse_us for each in pulses} <= {0.0, 1550.0}
        on_s = sorted(each.time_s for each in pulses if each.pulse_us)
        assert len(on_s) == N
        assert (np.diff(on_s) >= 0.24).all()


@pytest.mark.parametrize("kind", ["truncate", "corrupt"])
@pytest.mark.parametrize("crc", [False, True])
def test_damaged_bytes_cost_pulses_for_a_moment_at_most(kind, crc):
    face = put_together(faults=[PulseFault(kind=kind, at_s=3.0, every_s=1.0)], crc=crc)
    with face.bus:
        face.bridge.start()
        drive(face, 3.9)
        drive(face, 4.0)

        sent = [each.pulse_us for each in face.maestro.pulses]
        assert all(us == 0.0 or 1000.0 <= us <= 2000.0 for us in sent)
        assert face.bridge.state.value == "driven"
    assert last_us(face) == [0.0] * N


def test_a_plug_that_is_pulled_is_a_lost_port_and_comes_back():
    face = put_together(faults=[PulseFault(kind="unplug", at_s=3.0, lasts_s=1.0)])
    with face.bus:
        face.bridge.start()
        drive(face, 3.5)
        assert not face.bridge.plugged
        with pytest.raises(PortError):
            face.bus.write_positions(np.zeros(N))
        np.testing.assert_allclose(last_us(face), 1550.0, atol=1.0)  # pulses go on, as printed
        drive(face, 6.0)

        assert face.bridge.plugged
        np.testing.assert_allclose(last_us(face), 1550.0, atol=1.0)


def test_the_serial_timeout_stops_the_pulses_where_it_is_set():
    face = put_together(serial_timeout_s=0.5, port="/dev/x")
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        assert face.bus.capabilities.watchdog
        alone = face.bus.capabilities.stop_table()["computer dies, or the plug is pulled"]
        assert alone == "pulses off; a digital servo may hold"
        face.maestro.advance(face.clock.now() + 0.6)

        assert last_us(face) == [0.0] * N


@pytest.mark.parametrize("is_frozen", [False, True])
def test_after_a_tick_later_than_the_serial_timeout_servos_do_not_start_all_at_once(is_frozen):
    face = put_together(serial_timeout_s=0.5, port="/dev/x")
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        if is_frozen:
            face.bridge.stop(StopLevel.FREEZE)
        face.clock.advance(0.8)
        face.maestro.advance(face.clock.now())
        n_pulses = len(face.maestro.pulses)
        drive(face, 3.0)
        pulses = [each for each in list(face.maestro.pulses)[n_pulses:] if each.pulse_us]
        first_s = {each.channel: each.time_s for each in reversed(pulses)}

        assert len(first_s) == (0 if is_frozen else N)
        assert (np.diff(sorted(first_s.values())) >= 0.24).all()
        assert len(face.bridge.torque_by_name()["holds"]) == len(first_s)


def test_a_stop_sends_no_pulse_and_a_dry_run_sends_nothing_at_all():
    face = put_together()
    with face.bus:
        face.bridge.start()
        drive(face, 2.0)
        face.bridge.stop(StopLevel.LIMP)
        assert last_us(face) == [0.0] * N
    face = put_together()
    face.maestro.receive(bytes.fromhex("84 00 70 2e"), 0.0, BAUD_RATE)
    with face.bus:
        for _ in range(20):
            face.clock.advance(0.1)
            face.bus.look_after()
    assert last_us(face)[0] == 1500.0


def switch_off_and_on(face, name):
    for switch in (ServoSwitch.OFF, ServoSwitch.ON):
        face.bridge.obey(ServoOrder(name, switch), face.clock.now())
        drive(face, 3.0)


def fall_silent(face):
    """No targets for so long that the face is limp; then again."""
    for _ in range(round(7 * RATE_HZ)):
        face.clock.advance(1.0 / RATE_HZ)
        face.bridge.tick(face.clock.now())
    drive(face, 4.0)


def stop_and_start(face, _name):
    face.bridge.stop(StopLevel.LIMP)
    drive(face, 1.0)
    face.bridge.await_start()
    face.bridge.start(by_person=True)
    drive(face, 4.0)


@pytest.mark.parametrize("try_again", [switch_off_and_on, stop_and_start])
def test_a_channel_that_does_something_else_gets_no_pulses_until_a_person_tries_it(try_again):
    face, told = put_together(), []
    channel, name = face.maestro.channels[1], face.bridge.names[1]
    set_target, channel.set_target = channel.set_target, lambda us, *_: told.extend([us] * (us > 0))
    channel.position = channel.target = 200.0
    with face.bus:
        face.bridge.start()
        for n_told in (2, 4):  # no third try of its own, however long it is driven
            drive(face, 10.0)
            fall_silent(face)
            assert "its channel is set for something else" in face.bridge.troubles[0]
            assert len(told) == n_told
            if n_told == 4:
                channel.set_target, channel.position, channel.target = set_target, 0.0, 0.0
            try_again(face, name)

        assert face.bridge.troubles == ()
        assert last_us(face)[1] == 1550.0


def test_a_channel_that_misses_its_stop_is_told_again():
    face = put_together()
    channel, missed = face.maestro.channels[2], []
    set_target = channel.set_target
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        channel.set_target = lambda *to: set_target(*to) if missed else missed.append(to)
        assert not face.bus.disable_torque(2)
        for _ in range(60):
            face.clock.advance(0.02)
            face.bus.look_after()

        assert missed
        assert last_us(face)[2] == 0.0
        assert face.bus.torque.as_json()[2] is False


def test_a_channel_that_misses_one_pulse_is_not_accused():
    face = put_together()
    channel, missed = face.maestro.channels[1], []
    set_target = channel.set_target
    channel.set_target = lambda *to: set_target(*to) if missed or not to[0] else missed.append(to)
    with face.bus:
        face.bridge.start()
        drive(face, 4.0)

        assert missed
        assert face.bridge.troubles == ()


def test_of_a_maestro_that_hangs_no_servo_is_said_to_have_no_pulses():
    face = put_together()
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        face.maestro.deaf = True
        face.bridge.stop(StopLevel.LIMP)
        drive(face, 3.0)
        report = face.bridge.stop_report()
        assert (report.released, report.complete) == ((), False)
        assert set(report.unconfirmed.values()) == {"does not answer"}
        assert report.text().startswith(f"{N} servos may still be driven:\n  ")
        assert "confirmed" not in report.text()
        face.maestro.deaf = False
        assert face.bus.disable_all().all()
    assert last_us(face) == [0.0] * N


def test_of_a_maestro_that_says_nothing_after_a_replug_no_pulse_is_known():
    face = put_together()
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        assert face.bus.torque.as_json() == [True] * N
        say_nothing(face)
        face.bus.reopen()

        assert face.bus.torque.as_json() == [None] * N


def test_a_pulse_that_was_sent_to_a_maestro_that_says_nothing_is_not_known():
    face = put_together()
    with face.bus:
        assert face.bus.torque.as_json() == [False] * N
        say_nothing(face)
        assert face.bus.enable_torque(0) == ""
        face.bus.write_positions(np.zeros(N))
        assert last_us(face)[0] == 1500.0

        assert face.bus.torque.as_json() == [None] + [False] * (N - 1)
        face.clock.advance(1.5)
        assert (face.bus.look_after().silent_s >= 1.5).all()


def test_after_a_replug_of_a_maestro_that_lost_its_pulses_none_comes_by_itself():
    face = put_together()
    with face.bus:
        face.bridge.start()
        drive(face, 3.0)
        for channel in face.maestro.channels:
            channel.position = channel.target = 0.0
        face.bus.reopen()
        face.bus.write_positions(np.zeros(N))

        assert last_us(face) == [0.0] * N
        assert face.bus.torque.as_json() == [False] * N


def test_lips_that_time_out_frozen_while_another_bus_is_unplugged_get_no_pulse_again():
    lips, neck = put_together(serial_timeout_s=0.5, port="/dev/x"), MemoryFace(1)
    neck.clock = lips.clock
    buses = {"lips": lips.bus, "neck": neck.bus}
    bus = SeveralBuses(buses, [*["lips"] * N, "neck"], lips.clock, rate_hz=4.0)
    joints = [*lips.wiring.joints, *neck.joints]
    face = SimpleNamespace(**vars(lips))
    face.bridge = Bridge(bus, joints, lips.channel, BridgeSettings(RATE_HZ))
    with bus:
        face.bridge.start()
        drive(face, 4.0)
        face.bridge.stop(StopLevel.FREEZE)
        neck.chain.unplug()
        drive(face, 10.0)  # a look at one lip with each try to open the port
        assert not face.bridge.plugged
        assert face.bridge.torque_by_name()["holds"] == []
        neck.chain.plug_in()
        drive(face, 2.0)

        assert face.bridge.plugged
        assert set(face.bridge.torque_by_name()["holds"]) <= {"joint_1"}
        assert last_us(face) == [0.0] * N


def test_goals_beyond_the_range_are_taken_of_a_joint_that_was_widened_alone():
    face = put_together()
    pulses = [joint.pulse for joint in face.wiring.joints]
    with face.bus:
        face.bus.widen(np.arange(N) == 0)
        for beyond_us in ([p.min_us - 50.0 for p in pulses], [p.max_us + 50.0 for p in pulses]):
            goals_deg = [p.deg(us) for p, us in zip(pulses, beyond_us, strict=True)]
            face.bus.write_positions(np.array(goals_deg))
            assert (face.bus.read().errors == 0).tolist() == [True] + [False] * (N - 1)


def test_a_disk_that_cannot_keep_pulses_is_no_error(tmp_path):
    (tmp_path / "file").write_text("")
    KeptPulses(tmp_path / "file" / "pulses.json").write({0: 1500.0})


def test_pulses_that_cannot_be_kept_leave_no_file_behind(tmp_path):
    (tmp_path / "pulses.json").mkdir()  # cannot be replaced by a file
    KeptPulses(tmp_path / "pulses.json").write({0: 1500.0})
    assert [each.name for each in tmp_path.iterdir()] == ["pulses.json"]


def test_a_plug_is_known_by_its_numbers(tmp_path):
    from firmware_bridge.pulse_bus import usb_product

    device = tmp_path / "class/tty/ttyACM0/device"
    device.mkdir(parents=True)
    (device / "idVendor").write_text("1ffb\n")
    (device / "idProduct").write_text("0089\n")

    assert usb_product("/dev/ttyACM0", tmp_path) == "1ffb:0089"
    assert usb_product("/dev/ttyUSB0", tmp_path) == ""


@pytest.mark.parametrize(
    "text", ["faults: [{kind: rust, at_s: 1}]", "faults: 3", "x: [", "faults: [{kind: unplug}]"]
)
def test_a_script_that_cannot_be_used_says_where(text):
    with pytest.raises(ValueError, match=r"faults|YAML"):
        read_faults(text)


def test_a_log_that_cannot_be_written_is_an_error(tmp_path):
    with pytest.raises(ServoError, match="--log"):
        serve(None, None, SimulationRequest(log=tmp_path / "no" / "where"))


def test_shafts_run_and_hold():
    shaft = Shaft(1500.0)
    shaft.move(2000.0, 0.1)
    assert shaft.place_us == 1940.0
    shaft.move(0.0, 1.0)
    assert shaft.place_us == 1940.0
