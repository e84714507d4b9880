"""What of a person's stop outlives the process, a crash, and a power cut."""

import errno
import json
import os
import threading

import pytest

from firmware_bridge.process import stop_record
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
    assert "cannot be kept for a restart" in record.problem


@pytest.fixture
def disk(monkeypatch):
    """The calls of the operating system; what is in `errors` by call fails with that error."""
    errors = {}

    def failing(name, call):
        def called(*arguments):
            new = name == "open" and arguments[1] & os.O_CREAT
            if (number := errors.get("create" if new else name)) is not None:
                raise OSError(number, os.strerror(number))
            return call(*arguments)

        return called

    for name in ("open", "pwrite", "fdatasync"):
        monkeypatch.setattr(stop_record.os, name, failing(name, getattr(os, name)))
    return errors


def test_a_full_disk_keeps_a_stop_where_there_is_a_record_already(path, disk, caplog):
    first = StopRecord(path)
    assert first.problem_after(5.0) == ""
    before = path.stat()
    disk["create"] = errno.ENOSPC
    first.stop(STOP)

    assert first.problem_after(5.0) == ""
    assert first.problem == ""
    after = path.stat()
    assert (after.st_ino, after.st_size) == (before.st_ino, before.st_size)
    # As after a kill -9: nothing more is written.
    assert StopRecord(path).stopped is not None
    assert not caplog.messages


def test_a_record_of_the_form_of_before_is_read_and_kept_on_a_full_disk(path, disk):
    path.parent.mkdir()
    path.write_text('{"version": 1, "is_running": true, "boot": "", "stopped": "soft"}')
    disk["create"] = errno.ENOSPC
    record = StopRecord(path)
    assert record.stopped is not None
    record.stop(None)
    assert record.problem_after(5.0) == ""

    assert StopRecord(path).stopped is None


def test_a_full_disk_without_a_record_says_so_until_there_is_room(path, disk, monkeypatch, caplog):
    monkeypatch.setattr(stop_record, "_RETRY_S", 0.01)
    disk["create"] = errno.ENOSPC
    record = StopRecord(path)
    record.stop(STOP)
    words = f"{path}: a stop or start cannot be kept for a restart: No space left on device"

    assert record.problem_after(5.0) == words
    assert set(caplog.messages) == {words}
    assert len(caplog.messages) == 1
    del disk["create"]
    while record.problem:
        pass
    assert StopRecord(path).stopped is not None


@pytest.mark.parametrize(
    ("call", "number"), [("open", errno.EROFS), ("pwrite", errno.EIO), ("fdatasync", errno.EIO)]
)
def test_a_disk_that_fails_is_a_problem_of_the_very_stop(path, disk, call, number):
    record = StopRecord(path)
    assert record.problem_after(5.0) == ""
    disk.update({call: number, "create": number})
    record.stop(STOP)

    assert os.strerror(number) in record.problem_after(5.0)


def test_a_disk_that_hangs_is_waited_for_no_longer_than_was_said(path, monkeypatch):
    record = StopRecord(path)
    assert record.problem_after(5.0) == ""
    hangs = threading.Event()
    monkeypatch.setattr(stop_record.os, "fdatasync", lambda _: hangs.wait(5.0))
    record.stop(STOP)

    assert "has not written it within 0.01 s" in record.problem_after(0.01)
    hangs.set()
    assert record.problem_after(5.0) == ""


@pytest.mark.parametrize("n_kept", range(0, 360, 40))
def test_a_stop_that_was_cut_in_the_middle_of_its_write_holds_or_leaves_the_face_limp(path, n_kept):
    """The new text as far as it came, behind it the old record: as after a power cut."""
    record = StopRecord(path)
    assert record.problem_after(5.0) == ""
    old = path.read_bytes()
    record.stop(StopRequest(StopLevel.LIMP, "ü" * 10_000))
    assert record.problem_after(5.0) == ""
    new = path.read_bytes()
    cut_off = new[:n_kept] + old[n_kept:]
    path.write_bytes(cut_off)

    assert len(old) == len(new) == 4096
    assert StopRecord(path).stopped is not None or cut_off == old


def test_every_stop_and_start_is_handed_on(path):
    seen = []
    record = StopRecord(path, on_change=seen.append)
    record.stop(STOP)
    record.stop(None)

    assert seen == [STOP, None]
