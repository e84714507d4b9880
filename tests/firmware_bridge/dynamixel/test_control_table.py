"""The control tables against the vendor's own files, and against themselves."""

from importlib.resources import files
from itertools import pairwise

import pytest

from firmware_bridge.dynamixel.control_table import baud_rates, model_by_number, servo_models

MODELS = sorted(servo_models())


def sdk_table(model):
    """{name: (address, size)} from the *.model file that dynamixel-sdk ships."""
    folder = files("dynamixel_easy_sdk") / "control_table"
    lines = (folder / f"{model.lower().replace('-', '_')}.model").read_text().splitlines()
    rows = [line.split("\t") for line in lines[lines.index("[control table]") + 2 :] if line]
    names = {"secondary(shadow)_id": "secondary_id", "present_load": "present_current"}
    table = {}
    for address, size, name in rows:
        key = name.lower().replace(" ", "_")
        table[names.get(key, key)] = (int(address), int(size))
    return table


@pytest.mark.parametrize("name", MODELS)
def test_addresses_and_sizes_agree_with_the_sdk(name):
    model, sdk = servo_models()[name], sdk_table(name)
    shared = set(model.registers) & set(sdk)

    assert len(shared) >= 45
    assert {key: sdk[key] for key in shared} == {
        key: (model.registers[key].address, model.registers[key].size) for key in shared
    }


@pytest.mark.parametrize("name", MODELS)
def test_registers_do_not_overlap_and_eeprom_comes_before_ram(name):
    registers = sorted(servo_models()[name].registers.values(), key=lambda each: each.address)

    assert all(a.end <= b.address for a, b in pairwise(registers))
    assert all(each.in_eeprom == (each.address < 64) for each in registers)


@pytest.mark.parametrize("name", MODELS)
def test_factory_settings_lie_in_their_ranges(name):
    model = servo_models()[name]
    for key, value in model.defaults.items():
        entry = model.registers[key]
        assert entry.low is None or entry.low <= value, key
        assert entry.high is None or value <= entry.high, key
        assert entry.decode(entry.encode(value)) == value


def test_every_model_is_found_by_the_number_it_answers_with():
    assert {name: model_by_number(servo_models()[name].model_number).name for name in MODELS} == {
        name: name for name in MODELS
    }
    assert model_by_number(4711) is None


def test_the_models_that_measure_load_have_no_current_to_limit():
    model = servo_models()["XL430-W250"]

    assert not model.measures_current
    assert not {"goal_current", "current_limit"} & set(model.registers)


def test_a_million_baud_is_code_3():
    assert baud_rates()[3] == 1_000_000
