"""What of a person's stop outlives the process, a crash, and a power cut."""

import json

import pytest

from firmware_bridge.process.stop_record import StopRecord
from firmware_bridge.stopping import StopLevel, StopRequest

STOP = StopRequest(StopLevel.SOFT, "process 7 of user 1000")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "stops" / "face.json"


def written(path, **changes):
    """A record as a run has left it that was cut off in the middle."""
    path.unlink(missing_ok=True)
    record = StopRecord(path)
    record.close()
    state = {**json.loads(path.read_text()), "is_running": True, **changes}
    path.write_text(json.dumps(state))


def test_a_face_that_was_never_stopped_is_driven(path):
    assert StopRecord(path).stopped is None
    assert StopRecord(None).stopped is None


def test_a_stop_holds_in_the_next_process_and_a_start_takes_it_back(path):
    first = StopRecord(path)
    first.stop(STOP)
    first.close()
    second = StopRecord(path)
    assert second.stopped is not None
    assert second.stopped.level is StopLevel.LIMP
    assert "process 7 of user 1000 stopped it" in second.why
    second.stop(None)
    second.close()

    assert StopRecord(path).stopped is None


def test_a_person_who_starts_the_daemon_starts_the_face(path):
    first = StopRecord(path)
    first.stop(STOP)
    first.close()

    assert StopRecord(path, started_by_person=True).stopped is None


def test_a_crash_of_a_driven_face_is_no_stop_and_a_power_cut_may_have_swallowed_one(path):
    """Another boot id: the computer was off in between, and so were the servos."""
    written(path)
    assert StopRecord(path).stopped is None
    written(path, boot="another boot")
    cut_off = StopRecord(path)

    assert cut_off.stopped is not None
    assert "power was cut" in cut_off.why
    cut_off.close()
    written(path, boot="another boot")
    assert StopRecord(path, drives_after_power_cut=True).stopped is None


def test_the_ordinary_end_of_the_computer_is_no_power_cut(path):
    record = StopRecord(path)
    record.close()
    path.write_text(json.dumps({**json.loads(path.read_text()), "boot": "another boot"}))

    assert StopRecord(path).stopped is None


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b'{"version": 1, "stop'])
def test_a_record_that_cannot_be_read_leaves_the_face_limp(path, content):
    path.parent.mkdir()
    path.write_bytes(content)
    record = StopRecord(path)

    assert record.stopped is not None
    assert str(path) in record.why


def test_a_place_that_cannot_be_written_is_one_line_and_no_end(tmp_path, caplog):
    (tmp_path / "stops").write_text("a file")
    record = StopRecord(tmp_path / "stops" / "face.json")
    record.stop(STOP)
    record.close()

    assert record.stopped == STOP
    assert caplog.messages
    assert all("cannot be kept for a restart" in line for line in caplog.messages)


def test_every_stop_and_start_is_handed_on(path):
    seen = []
    record = StopRecord(path, on_change=seen.append)
    record.stop(STOP)
    record.stop(None)

    assert seen == [STOP, None]
