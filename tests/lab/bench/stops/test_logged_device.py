"""The log of simulated servos: each change of torque and pulses, on every kind of bus."""

import numpy as np
import pytest
from lipservo_lab.bench.stops.faces_on_buses import BUSES, SERIAL, face_yaml, logged_servos

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.settings.settings import load_shipped_face, parse_face


def wiring(bus):
    return parse_face(face_yaml(load_shipped_face("face_four"), bus), "face.yaml").wiring


@pytest.mark.parametrize("bus", BUSES)
def test_the_servos_of_every_bus_are_limp_in_the_beginning(bus):
    device = logged_servos(wiring(bus))
    device.advance(0.1)

    assert [each.on for each in device.records] == [(False,) * 4]
    assert device.plugged
    assert device.truth.shafts_deg().shape == (4,)
    assert bus in SERIAL or device.truth.pulses_us == (0.0,) * 4


def test_each_change_of_torque_is_logged_when_it_comes():
    on, clock = wiring("dynamixel"), ManualClock()
    device = logged_servos(on)
    bus = DynamixelBus(mounted_servos(on), lambda: MemoryTransport(device, clock, 1_000_000))
    with bus:
        bus.disable_all()
        assert bus.enable_torque(1) == ""
        assert bus.disable_torque(1)

    changes = [each.on[1] for each in device.records]
    assert changes == [False, True, False]
    times_s = [each.time_s for each in device.records]
    assert device.during(times_s[1], times_s[1]) == device.records[1:2]
    assert device.during(times_s[0] - 5.0, times_s[0] - 4.0) == device.records[:1]


def test_while_the_plug_is_out_nothing_arrives_and_servos_stay_as_they_are():
    device = logged_servos(wiring("maestro"))
    device.receive(bytes((0x84, 0, 0x70, 0x2E)), 0.1, 9600)
    device.unplug()
    device.receive(bytes((0x84, 0, 0, 0)), 0.2, 9600)
    device.advance(0.3)

    assert not device.plugged
    assert device.truth.on == (True, False, False, False)
    device.plug_in()
    device.receive(bytes((0x84, 0, 0, 0)), 0.4, 9600)
    assert device.truth.on == (False,) * 4
    assert np.all(device.travelled_deg(0.0) >= 0.0)
