"""Several boards on one I2C bus: whoever lets go of a port whose faces are dead knows them all."""

import pytest
from places import short_folder

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.settings import DynamixelSettings
from firmware_bridge.maestro.settings import MaestroSettings
from firmware_bridge.pca9685.i2c import I2cChip
from firmware_bridge.pca9685.registers import FULL, Register
from firmware_bridge.pca9685.settings import Pca9685Settings
from firmware_bridge.pca9685.simulator import MemoryTransfers, SimulatedPca9685
from firmware_bridge.process.port_record import buses_at, note_port
from lipservo.runtime.servos.letting_go import release


@pytest.fixture(autouse=True)
def own_folder(monkeypatch):
    monkeypatch.setenv("LIPSERVO_RUNTIME", str(short_folder()))


@pytest.fixture
def port(tmp_path):
    """In place of an I2C bus: a file whose node changes when it is made anew."""
    path = tmp_path / "i2c-1"
    path.touch()
    return path


def boards(port, *addresses):
    return [Pca9685Settings(port=str(port), address=each) for each in addresses]


def test_two_boards_at_one_port_are_both_known_by_what_was_driven_last(port):
    first, second = boards(port, 0x40, 0x41)
    note_port(first)
    note_port(second)
    slower = first.model_copy(update={"frequency_hz": 60.0})
    note_port(slower)

    assert [(kind.name, bus) for kind, bus in buses_at(str(port))] == [
        ("pca9685", slower),
        ("pca9685", second),
    ]


def test_what_was_plugged_in_anew_may_be_anything(port):
    note_port(boards(port, 0x40)[0])
    port.rename(port.with_name("unplugged"))
    port.touch()

    assert [(kind.name, bus) for kind, bus in buses_at(str(port))] == [("dynamixel", None)]


def test_nothing_is_written_to_servos_of_the_kind_that_was_there_before(port):
    note_port(DynamixelSettings(port=str(port)))
    maestros = [MaestroSettings(port=str(port), model="mini12", device=n) for n in (12, 13)]
    note_port(maestros[0])
    note_port(maestros[1])

    assert [bus for _, bus in buses_at(str(port))] == maestros


def test_a_port_whose_name_begins_like_another_is_another(port):
    longer = port.with_name("i2c-10")
    longer.touch()
    note_port(boards(longer, 0x40)[0])

    assert [kind.name for kind, _ in buses_at(str(port))] == ["dynamixel"]


@pytest.mark.parametrize("n_there", [2, 1])
def test_limp_at_the_port_switches_both_boards_off_and_names_one_that_is_gone(
    port, monkeypatch, n_there
):
    clock = ManualClock()
    chips = {address: SimulatedPca9685(address) for address in (0x40, 0x41)}
    for chip in chips.values():
        chip.registers[Register.LED15_OFF_H] = 0
    chips[0x41].nacks = 0 if n_there == 2 else 1_000

    def open_chip(path, address):
        return I2cChip(MemoryTransfers(chips[address], clock), address, f"{path} {address:#04x}")

    monkeypatch.setattr("firmware_bridge.pca9685.i2c.open_chip", open_chip)
    for each in boards(port, 0x40, 0x41):
        note_port(each)
    done = release(str(port))

    expected = [f"channel {n} at 0x40" for n in range(16)]
    expected += [f"channel {n} at 0x41" for n in range(16)] if n_there == 2 else []
    assert done.released == expected
    assert done.is_confirmed == (n_there == 2)
    assert "0x41" in done.problem or n_there == 2
    off = [bool(chip.registers[Register.LED15_OFF_H] & FULL) for chip in chips.values()]
    assert off == [True, n_there == 2]
