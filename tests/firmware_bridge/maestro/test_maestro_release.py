"""A simulated Maestro whose pulses are switched off by a program that did not drive it."""

from unittest.mock import Mock

import pytest
from maestro_face import put_together

from firmware_bridge.errors import PortError
from firmware_bridge.maestro.kind import BAUD_RATE
from firmware_bridge.maestro.release import MaestroRelease


@pytest.mark.parametrize("knows", [False, True])
@pytest.mark.parametrize("model", ["micro6", "mini18"])
def test_whatever_is_at_a_port_is_let_go(knows, model):
    face = put_together(model=model)
    for number in range(len(face.maestro.channels)):
        face.maestro.receive(bytes((0x84, number, 0x70, 0x2E)), 0.0, BAUD_RATE)
    release = MaestroRelease(face.opener(), "port", face.wiring.settings, knows=knows)
    found = release.find([] if knows else [2])
    release.close()

    assert list(found) == list(range(len(face.maestro.channels)))
    assert {channel.position for channel in face.maestro.channels} == {0.0}


def test_a_sensor_at_a_free_channel_does_not_keep_a_maestro_from_being_let_go():
    face = put_together(model="mini18")
    face.maestro.receive(bytes((0x84, 0, 0x70, 0x2E)), 0.0, BAUD_RATE)
    sensor = face.maestro.channels[9]
    sensor.position, sensor.set_target, sensor.move = 1023, Mock(), Mock()
    face.maestro._go_home = Mock()  # leaves an input as it is
    release = MaestroRelease(face.opener(), "port", face.wiring.settings, knows=False)

    assert list(release.find([])) == list(range(18))
    assert face.maestro.channels[0].position == 0.0


def test_a_maestro_that_does_not_hear_is_never_said_to_be_let_go():
    face = put_together(deaf=True)
    with pytest.raises(PortError, match="no Maestro answers"):
        MaestroRelease(face.opener(), "port", face.wiring.settings, knows=True).tell_all([0])


@pytest.mark.parametrize("lost", [3, 4])
def test_pulses_that_end_at_the_last_repeat_are_no_failure(lost):
    """Four times it is told in all; a line that loses the first three loses nothing."""
    face = put_together()
    face.maestro.receive(bytes((0x84, 0, 0x70, 0x2E)), 0.0, BAUD_RATE)
    release = MaestroRelease(face.opener(), "port", face.wiring.settings, knows=True)
    heard, told = face.maestro.receive, []

    def lossy(data, now_s, baud_rate):
        told.extend([data] if data[0] == 0x84 else [])
        if data[0] != 0x84 or len(told) > lost:
            heard(data, now_s, baud_rate)

    face.maestro.receive = lossy
    if lost == 3:
        release.tell_all([0])
    else:
        with pytest.raises(PortError, match=r"still drives channels \[0\]; switch"):
            release.tell_all([0])
    assert (face.maestro.channels[0].position == 0.0) == (lost == 3)
