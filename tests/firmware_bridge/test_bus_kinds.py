"""Kinds of bus by their names: built in, from other packages, unknown, and broken."""

import re
from importlib.metadata import EntryPoint

import pytest
from hobby_bus import PULSES, PULSES_KIND, WORDS
from places import ROOT
from typer.testing import CliRunner

from firmware_bridge import bus_kinds
from firmware_bridge.bus_kinds import GROUP, UnknownBusError, bus_kind, bus_names
from firmware_bridge.bus_settings import BusSettings
from firmware_bridge.capabilities import IN_MEMORY
from firmware_bridge.clock import ManualClock
from firmware_bridge.errors import BusError
from lipservo.cli import app
from lipservo.runtime.servos.assembly import bus_for
from lipservo.settings.settings import parse_face
from lipservo.settings.strict_yaml import SettingsError

FACE = """
name: hobby face
rate_hz: 50
bus: {kind: pulses, port: /dev/x}
servos:
  jaw: {channel: 3, positive: opens, min_deg: -2, max_deg: 25, max_speed_deg_s: 300}
  lip: {channel: 4, positive: raises, min_deg: -9, max_deg: 9, max_speed_deg_s: 300, part: brows}
"""


@pytest.fixture
def installed(monkeypatch):
    """Other packages with kinds of bus, by name."""
    points = {
        "pulses": EntryPoint("pulses", "hobby_bus:PULSES_KIND", GROUP),
        "broken": EntryPoint("broken", "no_such_module:KIND", GROUP),
        "strange": EntryPoint("strange", "hobby_bus:WORDS", GROUP),
        "simulated": EntryPoint("simulated", "no_such_module:KIND", GROUP),
    }

    def found(group, name=None):
        assert group == GROUP
        return [point for key, point in points.items() if name in (None, key)]

    monkeypatch.setattr(bus_kinds, "entry_points", found)
    bus_kind.cache_clear()
    yield
    bus_kind.cache_clear()


@pytest.mark.parametrize("name", ["simulated", "dynamixel"])
def test_a_kind_that_comes_with_lipservo_says_what_its_servos_can_do(name):
    kind = bus_kind(name)
    settings = kind.settings(kind=name, port="/dev/x")

    assert kind.name == name
    assert kind.capabilities(settings).in_memory is (name == "simulated")
    assert bus_kind(kind.at_port or name).name == "dynamixel"


@pytest.mark.usefixtures("installed")
def test_a_kind_of_another_package_is_found_by_its_entry_point():
    assert bus_names() == [
        "simulated", "dynamixel", "maestro", "pca9685", "feetech", "broken", "pulses", "strange",
    ]  # fmt: skip
    assert bus_kind("pulses") is PULSES_KIND
    assert bus_kind("simulated").capabilities(BusSettings()).in_memory


def test_an_unknown_kind_is_answered_with_those_there_are_and_how_to_get_another():
    with pytest.raises(UnknownBusError) as error:
        bus_kind("steamer")
    assert str(error.value) == (
        "bus kind 'steamer' is not known here; use one of simulated, dynamixel, maestro, pca9685, "
        "feetech, or install the package that provides it (entry point lipservo.buses)"
    )


@pytest.mark.usefixtures("installed")
def test_a_kind_that_cannot_be_loaded_says_why():
    with pytest.raises(UnknownBusError, match="bus plug-in broken: No module"):
        bus_kind("broken")
    with pytest.raises(UnknownBusError, match="strange: the package of this name is no bus"):
        bus_kind("strange")


@pytest.mark.usefixtures("installed")
def test_a_face_has_the_keys_of_its_bus():
    face = parse_face(FACE, "face.yaml")

    assert [(joint.name, joint.servo_id) for joint in face.joints()] == [("jaw", 3), ("lip", 4)]
    assert (face.bus.address, face.servo_port) == (12, "/dev/x")
    assert face.capabilities is PULSES
    assert face.servos["jaw"].make is None
    assert set(face.servos["jaw"].bounds.values()) == {None}
    with bus_for(face, ManualClock()) as bus:
        assert bus.capabilities.released_words == WORDS


@pytest.mark.parametrize(
    ("right", "wrong", "error"),
    [
        ("channel: 3", "id: 3", "servos.jaw.channel: is missing"),
        ("channel: 3", "chanel: 3", "servos.jaw.chanel: unknown setting; did you mean channel?"),
        (
            "channel: 3",
            "channel: 4",
            "servos: jaw and lip both have channel 4; every servo needs its own",
        ),
        (
            "port: /dev/x",
            "baud_rate: 1",
            "bus.baud_rate: unknown setting; known here: kind, port, address",
        ),
        (
            "kind: pulses",
            "kind: broken",
            "bus.kind: bus plug-in broken: No module named 'no_such_module'; "
            "reinstall or remove it",
        ),
    ],
)
@pytest.mark.usefixtures("installed")
def test_what_is_wrong_is_said_in_the_keys_of_the_bus(right, wrong, error):
    with pytest.raises(SettingsError) as errors:
        parse_face(FACE.replace(right, wrong, 1), "face.yaml")
    assert f"face.yaml.{error}" in str(errors.value).splitlines()


def test_what_a_kind_has_not_it_says_in_words():
    with pytest.raises(BusError, match="a bus of kind pulses has no simulator"):
        PULSES_KIND.simulator()
    with pytest.raises(
        BusError, match="a bus of kind pulses has no servos that could be found or set up"
    ):
        PULSES_KIND.workshop()
    with pytest.raises(BusError, match="a bus of kind pulses has no port"):
        PULSES_KIND.port_release("/dev/x", None)


def test_whoever_starts_such_a_face_is_told_what_a_stop_does():
    assert PULSES.warnings() == [
        f"stop: to neutral; then {WORDS}, which no servo confirms",
        f"stop --limp: {WORDS}, which no servo confirms",
        "stop --freeze: held at the goal sent last",
        "computer dies, or the plug is pulled: they go on to the goal sent last, and hold",
    ]
    assert not IN_MEMORY.warnings()


@pytest.mark.usefixtures("installed")
def test_a_joint_is_jogged_and_nobody_claims_to_know_where_it_stands(tmp_path):
    config = tmp_path / "hobby.yaml"
    config.write_text(FACE)
    done = CliRunner().invoke(app, ["jog", "jaw", "5", "--config", str(config), "--hold-s", "0.1"])

    assert done.exit_code == 0, done.output
    assert done.stdout == "jaw was sent to 5.0 deg\n"
    assert "which no servo confirms" in done.stderr
    assert f"2 servos let go, not confirmed: {WORDS}" in " ".join(done.stderr.split())


def test_what_a_stop_does_is_the_table_of_the_page():
    """docs/hardware.md, section "What a stop can do"."""
    text = (ROOT / "docs" / "hardware.md").read_text("utf-8")
    section = text.split("## What a stop can do\n")[1].split("\n## ")[0]
    rows = [
        [cell.strip() for cell in row.split("|")[1:-1]]
        for row in re.findall(r"^\|.*\|$", section, re.MULTILINE)
    ]
    ways = [way.strip("`") for way in rows[0][1:]]
    told = {row[0].strip("`"): dict(zip(ways, row[1:], strict=True)) for row in rows[2:]}

    for name in ("simulated", "dynamixel", "feetech", "pca9685", "pca9685 with oe_gpio"):
        kind = bus_kind(name.split()[0])
        pin = {"oe_gpio": 17} if "oe_gpio" in name else {}
        can = kind.capabilities(kind.settings(kind=kind.name, port="/dev/x", **pin))
        assert told[name] == dict(can.stop_table())
