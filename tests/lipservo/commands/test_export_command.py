"""`export` as its users meet it: the frames of `replay`, files that others read, refusals."""

import csv
import json
from itertools import pairwise

import numpy as np
import pytest
from in_process import lipservo, refused
from speech import CLIP_LABELS_PATH, CLIP_PATH, clip_start

from lipservo.rendering.spoken_sound import spoken_sound
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.traces.trace_file import read_trace
from lipsync.animpho.units import load_face_with_animphos
from lipsync.export.arkit import ARKIT_NAMES, ArkitMap, lip_measures
from lipsync.phoneme_files.reader import read_phonemes

LABELS = ("--phonemes", CLIP_LABELS_PATH)


def exported(*arguments):
    """What the command prints; it has to end well."""
    done = lipservo("export", *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def track(path):
    header, *rows = [json.loads(line) for line in path.read_text().splitlines()]
    times_s = np.array([row["time_s"] for row in rows])
    assert (np.diff(times_s) > 0.0).all()
    return header, times_s, np.array([row["values"] for row in rows])


def test_what_is_exported_are_the_frames_that_replay_shows(tmp_path):
    """The street's own trace, tick by tick; the recogniser listens in both."""
    two_seconds = clip_start(tmp_path, 2.0)
    assert not lipservo("replay", two_seconds, "-q", "--trace", tmp_path / "trace").returncode
    trace = read_trace(tmp_path / "trace")
    shown = (trace.sound_s >= 0.0) & (trace.sound_s <= 2.0)
    spoken = spoken_sound(two_seconds, None, ChosenMotion(), "face_sim", None)
    faces = [frame.coefficients for frame in spoken.frames(trace.sound_s[shown])]
    assert len(faces) == 60
    # Rounded times of a trace may be a block of sound earlier, and so may what was believed of it.
    model = load_face_with_animphos()
    apart_mm = model.markers_mm(np.array(faces)) - model.markers_mm(trace.coefficients[shown])
    assert np.abs(apart_mm).max() < 0.5
    assert np.abs(np.diff(faces, axis=0)).max() > 5.0

    exported(two_seconds, "-o", tmp_path / "a.jsonl", "--rate-hz", 50)
    header, times_s, values = track(tmp_path / "a.jsonl")
    assert header["names"] == list(ARKIT_NAMES)
    on_stage = spoken_sound(two_seconds, None, ChosenMotion(), "face_sim", None, stage=1.0)
    arkit = ArkitMap(lip_measures(load_face_with_animphos()))
    expected = [arkit.values(frame) for frame in on_stage.frames(times_s)]
    assert np.allclose(values, expected, atol=1e-5)


def test_closed_lips_of_known_phonemes_are_closed_on_the_avatar(tmp_path):
    exported(CLIP_PATH, *LABELS, "-o", tmp_path / "a.jsonl", "--rate-hz", 100)
    _, times_s, values = track(tmp_path / "a.jsonl")
    opening = values[:, ARKIT_NAMES.index("jawOpen")] - values[:, ARKIT_NAMES.index("mouthClose")]
    closing = [e for e in read_phonemes(CLIP_LABELS_PATH) if e.phoneme in ("P", "B", "M")]
    for event in closing:
        around = (times_s >= event.start_s - 0.04) & (times_s <= event.end_s + 0.04)
        assert opening[around].min() < 0.02, event
    assert len(closing) == 16
    assert opening.max() > 0.4


def test_a_csv_is_a_take_of_live_link_face(tmp_path):
    told = exported(CLIP_PATH, *LABELS, "-o", tmp_path / "take.csv", "--json")
    rows = list(csv.DictReader((tmp_path / "take.csv").read_text().splitlines()))
    assert json.loads(told)["n_frames"] == len(rows) == 517
    assert list(rows[0])[:3] == ["Timecode", "BlendShapeCount", "EyeBlinkLeft"]
    assert len(rows[0]) == 2 + 61
    assert [row["Timecode"] for row in (*rows[:2], rows[61])] == [
        "00:00:00:00.000", "00:00:00:01.000", "00:00:01:01.000",
    ]  # fmt: skip
    assert {row["BlendShapeCount"] for row in rows} == {"61"}
    assert max(float(row["JawOpen"]) for row in rows) > 0.4


@pytest.mark.parametrize("ending", ["jsonl", "csv"])
def test_visemes_are_a_mixture_of_15_at_every_time(tmp_path, ending):
    output = tmp_path / f"visemes.{ending}"
    exported(CLIP_PATH, *LABELS, "--format", "ovr", "-o", output)
    if ending == "jsonl":
        header, times_s, values = track(output)
        assert header["kind"] == "ovr"
        names = header["names"]
    else:
        names, *rows = list(csv.reader(output.read_text().splitlines()))
        times_s, values = np.array(rows, dtype=float)[:, 0], np.array(rows, dtype=float)[:, 1:]
        names = names[1:]
    assert len(names) == 15
    assert len(times_s) == 517
    assert np.allclose(values.sum(axis=1), 1.0, atol=1e-3)
    assert values[np.abs(times_s - 1.94).argmin(), names.index("PP")] > 0.9  # the M of "mouth"


@pytest.mark.parametrize("shapes", ["motion", "rules"])
def test_mouth_shapes_close_for_every_p_b_m(tmp_path, shapes):
    output = tmp_path / "cues.json"
    exported(CLIP_PATH, *LABELS, "--shapes", shapes, "-o", output)
    told = json.loads(output.read_text())
    assert told["metadata"] == {"soundFile": str(CLIP_PATH), "duration": 8.61}
    cues = told["mouthCues"]
    assert cues[0]["start"] == 0.0
    assert all(a["end"] == b["start"] for a, b in pairwise(cues))
    for event in read_phonemes(CLIP_LABELS_PATH):
        if event.phoneme in ("P", "B", "M"):
            near = [c for c in cues if c["start"] < event.end_s + 0.04]
            around = {c["value"] for c in near if c["end"] > event.start_s - 0.04}
            assert {"A", "X"} & around, event


def test_what_is_heard_alone_is_enough_and_an_export_is_written_over(tmp_path):
    two_seconds, output = clip_start(tmp_path, 2.0), tmp_path / "cues.tsv"
    for shapes in ("rules", "motion"):
        exported(two_seconds, "--shapes", shapes, "-o", output)
        rows = [line.split("\t") for line in output.read_text().splitlines()]
        assert rows[0] == ["0.00", "X"]
        assert rows[-1] == ["2.00", "X"]
        assert {shape for _, shape in rows} > {"A", "X"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-o", "a.mp4"], "a.mp4: this file type is unknown; use "),
        (["-o", "a.tsv", "--format", "arkit"], "a.tsv: a arkit file must end in .jsonl or .csv"),
        (["-o", "a.csv", "--rate-hz", "29.97"], "--rate-hz 29.97: a CSV needs whole frames"),
        (["-o", "none/a.tsv"], "there is no folder none"),
        (["-o", "other.csv"], "other.csv: exists already and is no export"),
        (["-o", "a.tsv", "--phonemes", "none.TextGrid"], "none.TextGrid: no such file"),
        (
            ["-o", "a.tsv", "--phonemes", "other.csv"],
            "other.csv: line 1 is neither labels nor JSON",
        ),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_no_file(tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.csv").write_text("my,own,table\n")
    assert said in refused("export", CLIP_PATH, *arguments)
    assert [path.name for path in tmp_path.iterdir()] == ["other.csv"]
    assert (tmp_path / "other.csv").read_text() == "my,own,table\n"
