"""Corpora that are not as they should be: `train` and `bench motion` work or say what is wrong."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import small_corpus
from in_process import lipservo
from lipservo_lab.learning.motion.trained_model import load_trained_model
from small_corpus import text_grid, write_corpus
from spoken_phonemes import spoken

from lipsync.motion.live_synthesizer import LIVE_STRATEGY, LiveSynthesizer
from lipsync.phonemes import PHONEMES, PhonemeUpdate

#: The bench's arguments that keep it short.
BRIEF = ("--strategy", LIVE_STRATEGY, "--lookahead-ms", "100", "--json", "-q")


def trained(folder: Path) -> Path:
    """Trains on a folder through the command line and gives the model's path."""
    path = folder.with_suffix(".npz")
    done = lipservo("learn", "face", folder, "-o", path, "-q")
    assert done.returncode == 0, done.stderr
    return path


def refused(folder: Path) -> str:
    """What `train` says where it refuses a folder; it must leave no file."""
    path = folder.with_name("refused.npz")
    done = lipservo("learn", "face", folder, "-o", path, "-q")
    assert done.returncode == 1
    assert not list(path.parent.glob("refused*"))
    return done.stderr.replace("\n", " ")


def scored(folder: Path, *options: object) -> tuple[dict, str]:
    """The one row that `bench motion` prints of a folder, and what it says beside."""
    done = lipservo("bench", "motion", "--corpus", folder, *options, *BRIEF)
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)["results"]
    return row | {"skipped": json.loads(done.stdout).get("skipped")}, done.stderr.replace("\n", " ")


def not_scored(folder: Path, *options: object) -> str:
    done = lipservo("bench", "motion", "--corpus", folder, *options, *BRIEF)
    assert done.returncode == 1
    return done.stderr.replace("\n", " ")


def test_one_utterance_trains_and_is_scored_but_cannot_be_cross_validated(tmp_path):
    folder = write_corpus(tmp_path / "one", 1)
    row, said = scored(folder, "--model", trained(folder))
    assert row["sentences"] == 1
    assert "the model has learned 1 of these sentences" in said
    (folder / "splits.json").write_text(json.dumps({"folds": [["s0"]], "new_words": {}}))
    assert "splits.json: split random leaves no sentence to train on" in not_scored(folder)


@pytest.mark.parametrize("absent", ["B", "AA", "SIL"])
def test_a_phoneme_that_the_corpus_lacks_is_played_and_scored(tmp_path, monkeypatch, absent):
    """A model that never heard B still closes the lips for it."""
    whole = write_corpus(tmp_path / "whole", 4)
    others = tuple(("D" if p == absent else p, s) for p, s in small_corpus.PHONES)
    monkeypatch.setattr(small_corpus, "PHONES", others)
    model = trained(write_corpus(tmp_path / "lacking", 4, seed=1))
    row, _ = scored(whole, "--model", model)
    assert row["sentences"] == 4
    assert np.isfinite(row["ratio"])
    learned = load_trained_model(model)
    assert not learned.baselines.counts[PHONEMES.index(absent)]
    synthesizer = LiveSynthesizer(learned, learned.expectation)
    phones = spoken(("SIL", 0.4), ("AA", 0.2), ("B", 0.1), ("UW", 0.2), ("SIL", 0.4))
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, phones))
    faces = [synthesizer.frame_at(tick / 100).coefficients for tick in range(130)]
    assert min(learned.lip_gap_mm(face) for face in faces[60:71]) <= 1.0


def freeze(folder: Path) -> None:
    for path in (folder / "landmarks").glob("*.npz"):
        with np.load(path) as file:
            points = file["landmarks_64th_px"]
        np.savez(path, landmarks_64th_px=np.repeat(points[:1], len(points), axis=0))


def test_constant_motion_teaches_nothing_and_is_scored_without_dividing_by_it(tmp_path):
    moving, still = write_corpus(tmp_path / "moving", 3), write_corpus(tmp_path / "still", 1)
    freeze(still)
    assert "the face never moves" in refused(still)
    row, _ = scored(still, "--model", trained(moving))
    assert row["acceleration_ratio"] is None
    assert row["gap_r"] == 0.0


@pytest.mark.parametrize(
    ("frame", "said"),
    [(np.nan, "s1.npz: has landmarks that are not numbers"), (0.0, "s1.npz: no face in frame 7")],
)
def test_frames_without_a_face_are_named_or_left_out_with_their_sentence(tmp_path, frame, said):
    folder = write_corpus(tmp_path / "c", 3)
    path = folder / "landmarks" / "s1.npz"
    with np.load(path) as file:
        points = file["landmarks_64th_px"].astype(np.float64)
    points[7] = frame
    np.savez(path, landmarks_64th_px=points)
    assert said in refused(folder)
    model = tmp_path / "m.npz"
    done = lipservo("learn", "face", folder, "-o", model, "--skip-bad", "--json", "-q")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["skipped"] == 1
    row, _ = scored(folder, "--model", model, "--skip-bad")
    assert len(row["skipped"]) == 1
    assert row["sentences"] == 2


@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 120.0])
def test_motion_of_any_frame_rate_trains_and_scores(tmp_path, monkeypatch, rate_hz):
    monkeypatch.setattr(small_corpus, "FRAME_RATE_HZ", rate_hz)
    folder = write_corpus(tmp_path / "c", 3)
    row, _ = scored(folder, "--model", trained(folder))
    assert np.isfinite(row["ratio"])
    # 0.6 s of speech in each of three sentences.
    assert row["frames"] == pytest.approx(3 * 0.6 * rate_hz, abs=3)


def relabel(folder: Path, change) -> None:
    path = folder / "landmarks.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))


def test_landmarks_in_another_order_are_the_same_face(tmp_path):
    models = []
    for name in ("c", "d"):
        folder = write_corpus(tmp_path / name, 3)
        if name == "d":
            relabel(folder, lambda layout: layout | {"landmark_ids": layout["landmark_ids"][::-1]})
            for path in (folder / "landmarks").glob("*.npz"):
                with np.load(path) as file:
                    points = file["landmarks_64th_px"]
                np.savez(path, landmarks_64th_px=points[:, ::-1])
        with np.load(trained(folder)) as file:
            models.append(file["animphos/samples"])
    np.testing.assert_allclose(*models)


def test_landmarks_numbered_differently_are_named(tmp_path):
    folder = write_corpus(tmp_path / "c", 2)

    def rename(layout: dict) -> dict:
        ids = ["lip" if n == 13 else n for n in layout["landmark_ids"]]
        return layout | {"landmark_ids": ids}

    relabel(folder, rename)
    assert "landmarks.json: landmark_ids lacks 13 (1 of" in refused(folder)


def test_a_model_of_markers_that_the_corpus_lacks_is_refused(tmp_path):
    folder = write_corpus(tmp_path / "c", 3)
    path = trained(folder)
    with np.load(path) as file:
        content = {key: file[key] for key in file.files}
    about = json.loads(content["about"].tobytes())
    about["layout"]["groups"]["nose"][0] = 4711
    content["about"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    np.savez(path, **content)
    assert "landmark_ids lacks 4711 (1 of" in not_scored(folder, "--model", path)


def test_a_folder_without_labels_says_so(tmp_path):
    model = trained(write_corpus(tmp_path / "labelled", 3))
    folder = write_corpus(tmp_path / "c", 2)
    for path in (folder / "labels").glob("*.TextGrid"):
        path.write_text(text_grid([("SIL", 1.2)]).replace('"phones"', '"sounds"'))
    assert "no sentence has a tier `phones`" in refused(folder)
    said = not_scored(folder, "--model", model)
    assert "no sentence has a tier `phones` in labels/ to score by" in said
