"""Models of other components and other points, trained on a small corpus, drive a face."""

import json
import math
import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from in_process import lipservo, refused
from lipservo_lab.learning.motion.trained_model import TrainedModel, load_trained_model
from small_corpus import write_corpus
from speech import clip_start
from spoken_phonemes import spoken

from lipsync.markers import MARKERS_39, MARKERS_47
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.phonemes import PhonemeUpdate

PHONES = spoken(("SIL", 0.4), ("AA", 0.2), ("B", 0.1), ("UW", 0.2), ("SIL", 0.4))


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    return write_corpus(tmp_path_factory.mktemp("corpus") / "c", 6)


LEARN = ("learn", "face", "--phonemes", "true", "--json", "-q")


def learned(corpus: Path, path: Path, *options: object) -> tuple[TrainedModel, dict]:
    """The model of a corpus, and what was printed of it."""
    done = lipservo(*LEARN, corpus, "-o", path, *options)
    assert done.returncode == 0, done.stderr
    return load_trained_model(path), json.loads(done.stdout)


def test_the_papers_own_model_is_trained_calibrated_and_plays(corpus, tmp_path):
    """Five components of 39 markers, from the recordings to the servo of a jaw."""
    path, calibration = tmp_path / "paper.npz", tmp_path / "face_jaw.calibration.yaml"
    model, said = learned(corpus, path, "--components", 5, "--markers", 39)
    assert (said["components"], said["points"], said["layout"]) == (5, 39, "markers-39")
    assert said["sentences"] == 6
    assert 0.5 < said["variance_held"] <= 1.0
    assert model.layout == MARKERS_39
    assert model.basis.shape == (5, 117)

    of_both = ("--config", "face_jaw", "--model", path)
    made = lipservo("calibrate", "fit", *of_both, "-o", calibration, "-q")
    assert made.returncode == 0, made.stderr
    face = tmp_path / "face.yaml"
    shutil.copy(str(resources.files("lipservo.config") / "face_jaw.yaml"), face)
    sound = clip_start(tmp_path)
    for strategy in ("expected", "priority"):
        trace = tmp_path / f"{strategy}.jsonl"
        how = ("--config", face, "--model", path, "--strategy", strategy, "--trace", trace)
        played = lipservo("replay", sound, *how, "-q")
        assert played.returncode == 0, played.stderr
        _, *ticks, _ = [json.loads(line) for line in trace.read_text().splitlines()]
        assert {len(tick["coefficients"]) for tick in ticks} == {5}
        assert np.ptp([tick["sent_deg"][0] for tick in ticks]) > 0.3


@pytest.mark.parametrize("n_components", [1, 3, 12])
def test_a_model_of_any_number_of_components_closes_the_lips(corpus, tmp_path, n_components):
    model, _ = learned(corpus, tmp_path / "m.npz", "--components", n_components)
    assert model.n_components == n_components
    assert model.layout == MARKERS_47
    synthesizer = LiveSynthesizer(model, model.expectation)
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, PHONES))
    faces = np.array([synthesizer.frame_at(tick / 100).coefficients for tick in range(130)])
    assert faces.shape == (130, n_components)
    assert np.isfinite(faces).all()


def test_a_mesh_given_by_a_file_is_learned_and_scored(corpus, tmp_path):
    """The 47 markers and three points of the skin; `bench motion` reads what the model has."""
    points = MARKERS_47.description()
    points["name"] = "mesh"
    points["groups"]["skin"] = [10, 6, 168]
    layout, path = tmp_path / "mesh.json", tmp_path / "m.npz"
    layout.write_text(json.dumps(points))
    model, _ = learned(corpus, path, "--markers", layout)
    assert model.mean_mm.shape == (50, 3)
    how = ("--model", path, "--strategy", "expected", "--lookahead-ms", 100, "--json", "-q")
    scored = lipservo("bench", "motion", "--corpus", corpus, *how)
    assert scored.returncode == 0, scored.stderr
    assert np.isfinite(json.loads(scored.stdout)["results"][0]["ratio"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--components", 0), "--components 0: a face of 47 points has 1 to 141"),
        (("--components", -3), "--components -3: a face of 47 points has 1 to 141"),
        (
            ("--components", 118, "--markers", 39),
            "components 118: a face of 39 points has 1 to 117",
        ),
        (("--components", 141), "30 frames are too few for --components 141"),
        (("--markers", 12), "12: neither a known layout (39, 47, 478) nor a readable file"),
        (("--markers", 478), "landmark_ids lacks 1, 3, 4, 5, 7, ..."),
    ],
)
def test_what_cannot_be_trained_is_refused_in_one_line(corpus, tmp_path, arguments, said):
    if arguments == ("--components", 141):
        corpus = write_corpus(tmp_path / "short", 1)
    assert said in refused(*LEARN, corpus, "-o", tmp_path / "m.npz", *arguments)
    assert not (tmp_path / "m.npz").exists()
