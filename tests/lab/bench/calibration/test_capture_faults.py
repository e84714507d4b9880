"""Faults done on purpose: named rightly, wrongly, or not at all."""

import pytest
from linear_face import MODEL, SERVOS, LinearFace
from lipservo_lab.bench.calibration import hard_captures as capture_faults
from lipservo_lab.bench.calibration.hard_captures import FaultCount, count_faults

from calibration.calibration import CalibrationError
from calibration.capture.sanity import CheckedCapture

NAMED, MISNAMED, SILENT = FaultCount(1, 1, 0), FaultCount(1, 0, 1), FaultCount(1, 0, 0)


@pytest.fixture(autouse=True)
def _short_captures(monkeypatch):
    """Twenty poses are enough for two servos."""
    monkeypatch.setattr(capture_faults, "_N_POSES", 20)


def counts(seed=1):
    return count_faults(MODEL, LinearFace(), SERVOS, seed)


def counts_where_said(monkeypatch, *said):
    monkeypatch.setattr(
        capture_faults, "check_capture", lambda capture, *_: CheckedCapture(capture, said)
    )
    return counts()


def test_on_a_robot_that_is_easily_read_every_fault_is_named():
    assert counts() == dict.fromkeys(capture_faults._WORDS, NAMED)


def test_silence_is_neither_right_nor_wrong(monkeypatch):
    assert set(counts_where_said(monkeypatch).values()) == {SILENT}


def test_that_a_marker_was_far_off_or_a_servo_weak_accuses_nobody(monkeypatch):
    said = ("3 readings were far off and left out: chin_199 3", "servo 'jaw' is weak or dead: ...")
    assert set(counts_where_said(monkeypatch, *said).values()) == {SILENT}


def test_another_fault_or_another_servo_is_wrong(monkeypatch):
    by_servo = {
        name: counts_where_said(monkeypatch, f"servo {name!r} slipped on its shaft at pose 9")
        for name in SERVOS.names
    }
    assert sorted((c["slipped"] for c in by_servo.values()), key=str) == sorted(
        (NAMED, MISNAMED), key=str
    )
    for found in by_servo.values():
        assert {c for fault, c in found.items() if fault != "slipped"} == {MISNAMED}


def test_a_refusal_counts_as_said(monkeypatch):
    def refuse(*_):
        raise CalibrationError("the markers are mirrored: x should grow to the robot's own left")

    monkeypatch.setattr(capture_faults, "check_capture", refuse)
    found = counts()
    assert found.pop("mirrored") == NAMED
    assert set(found.values()) == {MISNAMED}
