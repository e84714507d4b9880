"""`lipservo trace diff` as its users meet it, on edited copies of a recorded trace."""

import copy
import gzip
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import DATA
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.traces.trace_diff import motion_lag_s

CLIP = DATA / "traces" / "clip.jsonl.gz"
RECORDS = [json.loads(line) for line in gzip.decompress(CLIP.read_bytes()).splitlines()]


def written(path, edit=None, records=RECORDS):
    """A copy of the clip's trace in which `edit` changed the header and the ticks."""
    records = copy.deepcopy(records)
    if edit is not None:
        edit(records[0], records[1:-1])
    path.write_text("".join(json.dumps(each) + "\n" for each in records))
    return path


def diff(*arguments):
    done = CliRunner().invoke(app, ["trace", "diff", *map(str, arguments)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done


def figures(*arguments):
    return json.loads(diff(*arguments, "--json").stdout)


def test_a_trace_is_the_same_as_itself():
    done = diff(CLIP, CLIP, "--tolerance-mm", 0, "--tolerance-ms", 0, "--tolerance-deg", 0)

    assert done.exit_code == 0
    assert "the same within tolerance" in done.stdout


def test_motion_that_comes_later_is_measured_in_milliseconds(tmp_path):
    def later(_, ticks):
        for tick in ticks:
            tick["sound_s"] += 0.030

    late = written(tmp_path / "late.jsonl", later)
    found = figures(CLIP, late)

    assert found["lag_s"] == pytest.approx(0.030, abs=1e-3)
    assert np.median(found["closure_shifts_s"]) == pytest.approx(0.030, abs=2e-3)
    done = diff(CLIP, late)
    assert done.exit_code == 1
    assert "+30" in done.stdout


def test_a_servo_that_moves_otherwise_is_named_with_its_moment(tmp_path):
    def lift(_, ticks):
        for tick in ticks:
            if 4.0 < tick["sound_s"] < 4.2:
                tick["sent_deg"][3] += 3.0

    done = diff(CLIP, written(tmp_path / "b.jsonl", lift))

    assert done.exit_code == 1
    assert "beyond tolerance: lower_lip_left is up to 3.00 deg off" in done.stdout
    worst = figures(CLIP, tmp_path / "b.jsonl")["worst"][0]
    assert worst["servo"] == "lower_lip_left"
    assert 4.0 < worst["sound_s"] < 4.2
    assert worst["off_deg"] == pytest.approx(3.0)
    assert diff(CLIP, tmp_path / "b.jsonl", "--tolerance-deg", 3.1).exit_code == 0


def test_lips_that_no_longer_close_are_told_in_millimetres_with_the_phoneme(tmp_path):
    (closed,) = [t for t in RECORDS[1:-1] if abs(t["sound_s"] - 8.107) < 0.017]
    before = next(t for t in RECORDS[1:-1] if abs(t["sound_s"] - 7.5) < 0.02)

    def open_up(_, ticks):
        for tick in ticks:
            if abs(tick["sound_s"] - closed["sound_s"]) < 0.12:
                tick["coefficients"] = before["coefficients"]

    found = figures(CLIP, written(tmp_path / "b.jsonl", open_up))

    assert found["gap_mm"] > 3.0
    assert found["lost_closures_s"] == [pytest.approx(8.1, abs=0.1)]
    assert found["worst"][0]["sound_s"] == pytest.approx(8.1, abs=0.15)
    assert found["worst"][0]["phonemes"][0] in ("B", "IY", "G", "Z")
    assert any("closures are lost" in line for line in found["beyond"])


def test_the_same_motion_at_half_the_rate_differs_by_what_was_left_out_only(tmp_path):
    halved = [RECORDS[0], *RECORDS[1:-1:2], RECORDS[-1]]
    found = figures(CLIP, written(tmp_path / "b.jsonl", records=halved))

    assert abs(found["lag_s"]) < 0.005
    assert found["lips_rms_mm"] < 1.0
    assert found["ends_apart_s"] == 0.0


def elsewhere(_, ticks):
    for tick in ticks:
        tick["sound_s"] += 100.0


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (
            lambda head, _: head.update(servos=["chin", *head["servos"][1:]]),
            "have different servos: only one of them has chin",
        ),
        (lambda head, _: head.update(face="b"), "face 'simulated mouth', but b.jsonl of 'b'"),
        (lambda head, _: head.update(model="0123"), "was made with face model 0123"),
        (elsewhere, "have no sound time in common"),
        (lambda _, ticks: ticks[7].pop("sent_deg"), "damaged: 'sent_deg'"),
        (lambda _, ticks: ticks[7]["sent_deg"].pop(), "damaged"),
        (lambda _, ticks: ticks[7].update(sent_deg=[10**400] * 10), "damaged"),
        (lambda head, _: head.update(servos=[]), "damaged: it names no servo"),
        (lambda head, _: head.pop("lipservo_trace"), "not a lipservo trace"),
        (lambda head, _: head.update(lipservo_trace=9), "not a lipservo trace of version"),
        (lambda _, ticks: ticks[3].update(sound_s=-9.0), "damaged: its times do not increase"),
    ],
)
def test_traces_that_cannot_be_compared_end_in_one_line_and_status_2(tmp_path, edit, said):
    done = diff(CLIP, written(tmp_path / "b.jsonl", edit))

    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert said in line


@pytest.mark.parametrize("content", [b"", b"\x1f\x8b nonsense", b"{}\n", b"\xff\xfe\n[1]\n"])
@pytest.mark.parametrize("name", ["b.jsonl", "b.jsonl.gz"])
def test_what_is_no_trace_ends_in_one_line_and_status_2(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    done = diff(CLIP, path)

    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(("name", "packed"), [("b.jsonl", True), ("b.jsonl.gz", False)])
def test_whether_a_trace_is_packed_is_told_by_its_bytes_and_not_by_its_name(tmp_path, name, packed):
    path = tmp_path / name
    path.write_bytes(CLIP.read_bytes() if packed else gzip.decompress(CLIP.read_bytes()))

    assert diff(CLIP, path).exit_code == 0


@pytest.mark.parametrize("packed", [False, True])
def test_a_trace_that_was_cut_short_is_compared_as_far_as_it_goes_and_says_so(tmp_path, packed):
    whole = CLIP.read_bytes() if packed else gzip.decompress(CLIP.read_bytes())
    path = tmp_path / ("b.jsonl.gz" if packed else "b.jsonl.partial")
    path.write_bytes(whole[: len(whole) // 2])
    done = diff(CLIP, path)

    assert done.exit_code == 1
    assert f"{path.name} was cut short after" in done.stderr
    assert "s that the other does not" in done.stdout
    assert "lips are up to" not in done.stdout


def test_a_picture_is_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "both.svg"
    assert diff(CLIP, CLIP, "--plot", picture).exit_code == 0
    assert picture.stat().st_size > 10_000
    assert {each.name for each in tmp_path.iterdir()} == {picture.name}


def test_a_picture_of_another_kind_is_refused_before_anything_is_read(tmp_path):
    done = diff("none", "none", "--plot", tmp_path / "x.jpg")

    assert done.exit_code == 2
    assert "the plot's name must end in .png or .svg" in done.stderr


@settings(max_examples=25)
@given(lag_ms=st.integers(-120, 120), rate_hz=st.sampled_from([30.0, 50.0, 100.0]))
def test_the_lag_of_any_smooth_motion_is_found_within_a_millisecond(lag_ms, rate_hz):
    times_s = np.arange(0.0, 6.0, 1.0 / rate_hz)

    def motion(at_s):
        return sum(np.sin(2 * np.pi * f * at_s + f) / f for f in (0.7, 1.9, 3.1))

    found = motion_lag_s(times_s, motion(times_s), times_s, motion(times_s - lag_ms * 1e-3))

    assert found == pytest.approx(lag_ms * 1e-3, abs=2e-3)


def test_what_stands_still_has_no_lag():
    times_s = np.arange(0.0, 3.0, 0.01)
    assert motion_lag_s(times_s, np.ones(300), times_s, np.sin(times_s)) is None
