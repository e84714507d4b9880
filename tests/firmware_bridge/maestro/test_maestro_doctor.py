"""What the doctor says of a simulated Maestro: its pulses, its errors and its serial timeout."""

from maestro_face import N, put_together, say_nothing

from firmware_bridge.bus_kinds import Severity, bus_kind
from firmware_bridge.maestro.protocol import CRC_ERROR, describe_errors


def examined(face, monkeypatch):
    monkeypatch.setattr("firmware_bridge.maestro.kind._opener", lambda _port: face.opener)
    return list(bus_kind("maestro").examine(face.wiring))


def test_the_doctor_says_what_happens_when_the_computer_dies(monkeypatch):
    for timeout_s, really_s, said in (
        (0.0, 0.0, "when the computer dies the servos are held"),
        (0.5, 0.5, "stops its pulses by itself after 0.5 s"),
        (0.5, 0.0, "serial_timeout_s is 0.5, but its serial timeout is off"),
    ):
        really = {"serial_timeout_s": really_s}
        face = put_together(port="/dev/x", serial_timeout_s=timeout_s, really=really)
        findings = [each.what for each in examined(face, monkeypatch)]

        assert "a Maestro answers at /dev/x" in findings[0]
        assert "gets no pulses" in findings[1]
        assert said in findings[-1]


def test_the_doctor_tells_of_errors_that_were_stored_before_it_came(monkeypatch):
    face = put_together(port="/dev/x")
    face.maestro.errors = CRC_ERROR
    told = [each.what for each in examined(face, monkeypatch)]

    assert f"it tells of a {describe_errors(CRC_ERROR)[0]}" in told


def test_a_pulse_that_the_maestro_does_not_tell_is_bad_and_no_number(monkeypatch):
    face = put_together(port="/dev/x")
    say_nothing(face)
    found = examined(face, monkeypatch)
    bad = [each.what for each in found if each.severity is Severity.BAD]

    assert [each.endswith("no answer to what it is sent") for each in bad] == [True] * N
    assert not any("nan" in each.what for each in found)
