"""Ticks and degrees: each path between them, for every model of servo, by the model's own table."""

import contextlib
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from calibration.capture.lerobot_ranges import read_ranges
from firmware_bridge.bus_kinds import bus_kind
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel import control_table as dynamixel
from firmware_bridge.errors import ServoError
from firmware_bridge.feetech import control_table as feetech
from firmware_bridge.joints import Joint
from firmware_bridge.serial_servos.mounting import MountedServo, Mounting
from lipservo.runtime.servos.new_face import FoundJoint
from lipservo.settings.settings import parse_face
from lipsync.errors import UserError

#: By their manuals: values of the position register, and the degrees that all of them are.
MANUALS = {
    **dict.fromkeys(dynamixel.servo_models(), (4096, 360.0)),
    **{"STS3215": (4096, 360.0), "STS3250": (4096, 360.0), "SCS0009": (1024, 300.0)},
}
MODELS = {**dynamixel.servo_models(), **feetech.servo_models()}


def mounted(model, sign=1, offset_deg=0.0, ends=(-20.0, 20.0)):
    return MountedServo(Joint("jaw", 1, *ends, 60.0), model, sign, offset_deg)


@pytest.mark.parametrize("name", MODELS)
def test_a_step_of_each_model_is_as_large_as_its_manual_says(name):
    n_positions, reach_deg = MANUALS[name]
    servo = mounted(MODELS[name])

    assert MODELS[name].n_positions == n_positions
    assert servo.pulse(0.0) == n_positions // 2
    assert servo.pulse(reach_deg / 4) == pytest.approx(0.75 * n_positions, abs=1)


@given(
    name=st.sampled_from(sorted(MODELS)),
    deg=st.floats(-60.0, 60.0),
    offset_deg=st.floats(-60.0, 60.0),
    sign=st.sampled_from([1, -1]),
)
def test_degrees_come_back_from_ticks_within_half_a_step(name, deg, offset_deg, sign):
    servo = mounted(MODELS[name], sign, offset_deg)
    there = Mounting([servo])
    n_positions, reach_deg = MANUALS[name]

    pulses = there.pulses(np.array([deg]))
    assert pulses[0] == pytest.approx(servo.pulse(deg), abs=1)
    assert there.joint_deg(pulses)[0] == pytest.approx(deg, abs=0.51 * reach_deg / n_positions)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["XL330-M288", "STS3215", "SCS0009"])
def test_every_end_that_a_yaml_may_have_is_a_position_of_the_servo(name, sign):
    """Half a step below the full turn rounds to a position that no servo has."""
    kind = "dynamixel" if name in dynamixel.servo_models() else "feetech"
    keys = {"id": 1, "model": name, "positive": "opens", "max_speed_deg_s": 60.0, "sign": sign}
    n_positions, reach_deg = MANUALS[name]
    accepted = []
    for end_deg in np.linspace(reach_deg / 2 - 1.0, reach_deg / 2, 500).tolist():
        ends = (
            {"min_deg": -end_deg, "max_deg": 0.0}
            if sign < 0
            else {"min_deg": 0.0, "max_deg": end_deg}
        )
        with contextlib.suppress(ValidationError):
            bus_kind(kind).servo(**keys, **ends)
            accepted.append(mounted(MODELS[name], sign).pulse(sign * end_deg))

    assert max(accepted) == n_positions - 1


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", MODELS)
def test_a_recorded_range_becomes_limits_and_a_neutral_where_the_servo_stands(tmp_path, name, sign):
    """The servo stands off its middle; its range is a quarter of all positions."""
    model = MODELS[name]
    step_deg = MANUALS[name][1] / MANUALS[name][0]
    stands = model.n_positions // 2 + 40
    entry = {"id": 1, "drive_mode": 0, "homing_offset": 0}
    entry |= {"range_min": stands - 100, "range_max": stands + model.n_positions // 8}
    (tmp_path / "ranges.json").write_text(json.dumps({"jaw": entry}))
    recorded = read_ranges(tmp_path / "ranges.json")["jaw"]

    joint = FoundJoint("jaw", 1, name, "opens", sign).within(recorded, stands, model)

    ends_deg = sorted((-sign * 100 * step_deg, sign * model.n_positions // 8 * step_deg))
    assert (joint.min_deg, joint.max_deg) == pytest.approx(ends_deg, abs=0.01)
    servo = mounted(model, sign, joint.zero_offset_deg, (joint.min_deg, joint.max_deg))
    assert abs(servo.pulse(0.0) - stands) <= 1
    assert servo.pulse_range() == pytest.approx((entry["range_min"], entry["range_max"]), abs=1)


def test_a_range_of_another_model_is_refused(tmp_path):
    entry = {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 400, "range_max": 2000}
    (tmp_path / "ranges.json").write_text(json.dumps({"jaw": entry}))
    recorded = read_ranges(tmp_path / "ranges.json")["jaw"]

    with pytest.raises(
        UserError, match="range_max 2000 is beyond an SCS0009's positions, 0 to 1023"
    ):
        FoundJoint("jaw", 1, "SCS0009", "opens", 1).within(recorded, 512, MODELS["SCS0009"])


@pytest.mark.parametrize("name", MODELS)
def test_a_range_of_the_whole_turn_leaves_careful_limits(tmp_path, name):
    model = MODELS[name]
    entry = {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 0}
    (tmp_path / "ranges.json").write_text(
        json.dumps({"jaw": entry | {"range_max": model.n_positions - 1}})
    )
    recorded = read_ranges(tmp_path / "ranges.json")["jaw"]

    joint = FoundJoint("jaw", 1, name, "opens", 1).within(recorded, model.center_pulse, model)
    assert (joint.min_deg, joint.max_deg, joint.zero_offset_deg) == (-10.0, 10.0, 0.0)
    turns = FoundJoint("jaw", 1, name, "opens", 1).within(
        recorded, model.center_pulse, model, turns_all_the_way=True
    )
    half_deg = MANUALS[name][1] / 2
    assert (turns.min_deg, turns.max_deg) == pytest.approx((-half_deg, half_deg), abs=0.4)


SCS = """\
name: f
rate_hz: 30
bus: {kind: feetech, port: /dev/ttyUSB0, baud_rate: 1000000}
servos:
  jaw: {id: 1, model: SCS0009, positive: opens, min_deg: -9.84, max_deg: 9.49, max_speed_deg_s: 60,
    sign: 1, zero_offset_deg: OFFSET}
"""


def test_a_neutral_that_an_older_new_face_put_wrong_is_not_driven_to():
    """Of an SCS0009 that stood at 512, it wrote -135."""
    with pytest.raises(
        UserError, match=r"zero_offset_deg -135 puts neutral near the end of an SCS"
    ):
        parse_face(SCS.replace("OFFSET", "-135.0"), "f.yaml")
    assert (
        parse_face(SCS.replace("OFFSET", "-12.5"), "f.yaml").servos["jaw"].zero_offset_deg == -12.5
    )


@pytest.mark.parametrize("port", ["", "port: /dev/ttyACM7, "])
def test_channels_of_a_board_are_checked_without_a_port(port):
    face = (
        f"name: skull\nrate_hz: 50\nbus: {{kind: maestro, {port}model: micro6}}\nservos:\n"
        "  jaw: {channel: 6, positive: opens, min_deg: -2, max_deg: 25, max_speed_deg_s: 300, "
        "us_per_deg: 11.1, neutral_us: 1500, min_us: 1450, max_us: 1800}\n"
    )
    settings = parse_face(face, "skull.yaml")

    with pytest.raises(ServoError, match="a Maestro micro6 has channels 0 to 5"):
        settings.bus_kind.open(settings.wiring, ManualClock())


@pytest.mark.parametrize("port", ["", "port: /dev/i2c-77, "])
def test_a_channel_that_no_pca9685_has_is_refused_without_a_port(port):
    face = (
        f"name: skull\nrate_hz: 50\nbus: {{kind: pca9685, {port}frequency_hz: 50}}\nservos:\n"
        "  jaw: {channel: 16, positive: opens, min_deg: -2, max_deg: 25, max_speed_deg_s: 300, "
        "us_per_deg: 11.1, neutral_us: 1500, min_us: 1450, max_us: 1800}\n"
    )
    with pytest.raises(UserError, match=r"channel 16 is outside 0\.\.15"):
        parse_face(face, "skull.yaml")
