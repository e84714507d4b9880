"""A face YAML with several buses: the keys of each servo's own kind, and what is refused."""

import pytest

from lipservo.settings.settings import load_shipped_face, parse_face
from lipservo.settings.strict_yaml import SettingsError

FACE = """
name: mixed
rate_hz: 50
buses:
  lips: {kind: maestro, model: mini12}
  neck: {kind: dynamixel, port: /dev/ttyUSB0}
servos:
  jaw: {bus: lips, channel: 3, positive: opens, min_deg: -2, max_deg: 25, max_speed_deg_s: 300,
        us_per_deg: 11.1, min_us: 1400, max_us: 1800}
  yaw: {bus: neck, id: 3, model: XL430-W250, part: neck, positive: turns left, min_deg: -60,
        max_deg: 60, max_speed_deg_s: 120}
"""
PITCH = """  pitch: {bus: neck, id: 3, model: XL430-W250, part: neck, positive: nods down,
          min_deg: -20, max_deg: 20, max_speed_deg_s: 120}
"""


def face(text=FACE):
    return parse_face(text, "face.yaml")


def test_each_servo_has_the_keys_of_its_own_bus_and_the_same_address_may_be_on_both():
    jaw, yaw = face().servos.values()

    assert (jaw.channel, yaw.id, yaw.model) == (3, 3, "XL430-W250")
    assert face().bus_of == ("lips", "neck")
    assert [joint.address_key for joint in face().joints()] == ["channel", "id"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("bus: lips, ", "", "servos.jaw.bus: is missing; the buses of this face: lips, neck"),
        ("bus: lips", "bus: lisp",
         "servos.jaw.bus: 'lisp' is not one of the buses of this face: lips, neck"),
        ("channel: 3", "chanel: 3", "servos.jaw.chanel: unknown setting; did you mean channel?"),
        ("id: 3", "channel: 3", "servos.yaw.id: is missing"),
        ("model: mini12", "modle: mini12", "buses.lips.modle: unknown setting; did you mean model"),
        ("kind: maestro", "kind: steamer", "buses.lips.kind: bus kind 'steamer' is not known here"),
        ("lips: {kind", "Lips: {kind", "buses.Lips: 'Lips' does not have the form"),
        ("lips: {kind: maestro, model: mini12}", "lips: 5", "buses.lips: 5 is not settings of its"),
        ("buses:", "bus: {}\nbuses:", "bus: this face has `bus` and `buses`"),
        ("mini12}", "mini12, port: /dev/ttyUSB0}",
         "buses lips and neck both have port /dev/ttyUSB0"),
        ("mini12}", "mini12}\n  eyes: {}", "buses.eyes has no servo (`bus: eyes`)"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said_where_it_stands(old, new, said):
    with pytest.raises(SettingsError) as error:
        face(FACE.replace(old, new, 1))
    assert said in str(error.value)


def test_an_address_is_refused_twice_on_one_bus_only():
    with pytest.raises(SettingsError, match="yaw and pitch both have id 3 on bus neck; every"):
        face(FACE + PITCH)
    assert len(face(FACE + PITCH.replace("id: 3", "id: 4")).servos) == 3


CHIPS = """
name: chips
rate_hz: 50
buses:
  a: {kind: pca9685, i2c_bus: 1}
  b: {kind: pca9685, i2c_bus: 1, address: 0x41}
servos:
  jaw: {bus: a, channel: 3, positive: opens, min_deg: -2, max_deg: 25, max_speed_deg_s: 300,
        us_per_deg: 10}
  lip: {bus: b, channel: 3, positive: opens, min_deg: -2, max_deg: 25, max_speed_deg_s: 300,
        us_per_deg: 10}
"""


def test_two_chips_may_share_an_i2c_bus_by_their_addresses():
    assert face(CHIPS).servo_port == "a=/dev/i2c-1,b=/dev/i2c-1"
    with pytest.raises(SettingsError, match="buses a and b both have port /dev/i2c-1"):
        face(CHIPS.replace("0x41", "0x40"))


def test_two_boards_do_not_share_an_oe_pin_unless_it_is_of_another_gpio_chip():
    text = CHIPS.replace("i2c_bus: 1", "i2c_bus: 1, oe_gpio: 17")
    with pytest.raises(SettingsError, match="buses a and b both have oe_gpio 17 of /dev/gpiochip0"):
        face(text)
    assert face(text.replace("17, address", "17, gpio_chip: /dev/gpiochip1, address")).buses


def test_ports_are_one_text_and_one_without_a_name_is_refused():
    whole = face()

    assert whole.servo_port == "neck=/dev/ttyUSB0"  # the lips are simulated
    moved = whole.at_port("lips=/dev/ttyACM0")
    assert moved.servo_port == "lips=/dev/ttyACM0,neck=/dev/ttyUSB0"
    assert moved.at_port(moved.servo_port) == moved
    with pytest.raises(SettingsError, match="--port lips=PORT --port neck=PORT"):
        whole.at_port("/dev/ttyUSB1")
    with pytest.raises(SettingsError, match="has no bus eyes; its buses: lips, neck"):
        whole.at_port("eyes=/dev/ttyUSB1")


def test_the_servos_of_one_bus_are_a_face_of_their_own():
    alone = face().alone

    assert list(alone) == ["lips", "neck"]
    assert list(alone["neck"].servos) == ["yaw"]
    assert alone["neck"].bus_kind.name == "dynamixel"
    assert alone["lips"].capabilities.confirmed_limp is False
    with pytest.raises(
        SettingsError, match="has several buses: lips, neck; choose with --bus NAME"
    ):
        _ = face().bus_kind


def test_a_simulated_bus_at_a_port_is_real():
    head = load_shipped_face("face_head_mixed")

    assert head.servo_port is None
    assert head.at_port("neck=/dev/ttyUSB0").buses["neck"].kind == "dynamixel"
