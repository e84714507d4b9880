"""The servo health log on disk."""

import json
import math
import os
import threading
from datetime import timedelta

import pytest
from logged import logged as logged_lines
from logged_servos import NOON, servo

from lipservo.health.health_history import read_history
from lipservo.health.health_log import (
    HealthLog,
    append_line,
    health_log,
    json_line,
    log_folder,
    prune,
)


def logged(folder, readings, moments=(NOON,)):
    """Write up to eight readings, one at each of `moments` in turn; what was logged."""
    times = [moment.timestamp() for moment in moments]
    turn = iter(range(len(readings)))
    with (
        logged_lines("lipservo.health") as lines,
        HealthLog(folder, lambda: times[next(turn) % len(times)]) as log,
    ):
        for reading in readings:
            log.offer(reading)
    return lines


def lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_reading_is_one_line_of_json_in_the_file_of_its_utc_day(tmp_path):
    just_before, just_after = NOON.replace(hour=23, minute=59), NOON + timedelta(hours=12)
    said = logged(
        tmp_path / "mouth",
        [(servo(), servo("lip", temperature_degc=math.nan, current_ma=None)), (servo(),)],
        (just_before, just_after),
    )

    assert said == []
    assert sorted(os.listdir(tmp_path / "mouth")) == ["2026-11-22.jsonl", "2026-11-23.jsonl"]
    (line,) = lines(tmp_path / "mouth" / "2026-11-22.jsonl")
    assert line["time"] == "2026-11-22T23:59:00Z"
    assert (line["servos"], line["temperature_degc"]) == (["jaw", "lip"], [40, None])
    assert line["current_ma"] == [180, None]


def test_offers_return_at_once_while_the_disk_hangs_and_few_wait(tmp_path, monkeypatch):
    real, answers = os.write, threading.Event()

    def write(descriptor, data):
        assert answers.wait(60.0)
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", write)
    with HealthLog(tmp_path, lambda: NOON.timestamp()) as log:
        for _ in range(1_000):
            log.offer((servo(),))  # would hang here
        answers.set()

    assert 1 <= len(lines(tmp_path / "2026-11-22.jsonl")) <= 9


@pytest.mark.parametrize("obstacle", ["file", "pipe"])
def test_a_place_that_cannot_be_written_is_said_once(tmp_path, obstacle):
    folder = tmp_path / "mouth"
    if obstacle == "file":
        folder.write_text("not a folder")
    else:
        folder.mkdir()
        os.mkfifo(folder / "2026-11-22.jsonl")
    said = logged(folder, [(servo(),)] * 5)

    (line,) = said
    assert "cannot be written" in line
    assert "the face goes on" in line


def test_a_full_disk_is_said_once_and_the_log_goes_on_when_there_is_room(tmp_path, monkeypatch):
    real, full = os.write, [True]

    def write(descriptor, data):
        return real(descriptor, data[:20]) if full[0] else real(descriptor, data)

    monkeypatch.setattr(os, "write", write)
    said = logged(tmp_path, [(servo(),)] * 2)
    full[0] = False
    said += logged(tmp_path, [(servo(),)])

    assert len(said) == 1
    history = read_history([tmp_path], 30)
    assert (history.n_readings, history.n_bad_lines) == (1, 2)


def test_a_line_that_a_power_cut_tore_spoils_no_other(tmp_path):
    path = tmp_path / "2026-11-22.jsonl"
    whole = json_line(NOON, 0, [servo()])
    append_line(path, whole)
    path.write_bytes(path.read_bytes() + whole[:30])
    append_line(path, whole)

    assert path.read_bytes() == whole + whole[:30] + b"\n" + whole


def test_days_beyond_the_bounds_go_oldest_first_and_nothing_else(tmp_path):
    for day in range(1, 31):
        (tmp_path / f"2026-11-{day:02}.jsonl").write_bytes(b"x" * 100)
    (tmp_path / "notes.txt").write_bytes(b"mine" * 1000)
    (tmp_path / "2026-11-01.jsonl.bak").write_bytes(b"mine")

    prune(tmp_path, "2026-12-01.jsonl", most_days=30)
    left = sorted(os.listdir(tmp_path))
    assert "2026-11-01.jsonl" not in left
    assert "2026-11-02.jsonl" in left
    prune(tmp_path, "2026-12-01.jsonl", most_days=30, most_bytes=500)
    left = sorted(os.listdir(tmp_path))
    assert [name for name in left if name.endswith(".jsonl")] == [
        f"2026-11-{day}.jsonl" for day in range(26, 31)
    ]
    assert {"notes.txt", "2026-11-01.jsonl.bak"} < set(left)


def test_a_clock_that_is_wrong_for_a_while_costs_no_other_day(tmp_path):
    logged(tmp_path, [(servo(),)] * 3, (NOON, NOON.replace(year=2099), NOON.replace(year=1970)))

    assert sorted(os.listdir(tmp_path)) == [
        "1970-11-22.jsonl", "2026-11-22.jsonl", "2099-11-22.jsonl",
    ]  # fmt: skip


def test_only_servos_at_a_port_are_logged_and_simulated_ones_apart(tmp_path, caplog):
    assert health_log("mouth", None, {"HOME": str(tmp_path)}) is None
    home = {"HOME": "/home/ada"}
    folder = log_folder("My Face, 2", "/dev/ttyUSB0", home)
    assert str(folder) == "/home/ada/.local/state/lipservo/health/my-face-2"
    host, guest = os.openpty()
    folder = log_folder("../etc", os.ttyname(guest), {"XDG_STATE_HOME": "/s", **home})
    assert str(folder) == "/s/lipservo/health/etc-simulated"
    os.close(host)
    os.close(guest)
    folder = log_folder("a", "/dev/ttyUSB0", {"LIPSERVO_STATE": "/var/lib/lipservo", **home})
    assert str(folder) == "/var/lib/lipservo/health/a"
    assert health_log("a", "/dev/ttyUSB0", {}) is None
    assert "LIPSERVO_STATE" in caplog.messages[0]
