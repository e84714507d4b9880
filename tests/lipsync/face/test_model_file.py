"""Model files: who plays a face reads only what it plays; files of other versions are refused."""

import json
import re
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from lipservo_lab.learning.motion.trained_model import TrainedModel, load_trained_model, save_model
from speech import CLIP_PATH
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipsync.errors import UserError
from lipsync.face.model import ModelError, load_face
from lipsync.recognition.network import (
    ADAPTED_FROM,
    load_shipped_weights,
    save_weights,
    weights_digest,
)

PARTS = {"face", "expectation", "animphos", "baselines"}


@pytest.fixture(scope="module")
def shipped() -> TrainedModel:
    return load_trained_model()


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    samples, rate_hz = soundfile.read(CLIP_PATH)
    path = tmp_path_factory.mktemp("sound") / "short.wav"
    soundfile.write(path, samples[: int(0.6 * rate_hz)], rate_hz)
    return path


def with_junk(model: TrainedModel, path: Path, *parts: str) -> Path:
    """Write a model file in which these parts hold junk instead of arrays; return its path."""
    save_model(model, path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, b"junk" if name.split("/")[0] in parts else content)
    return path


def replay(sound: Path, model: Path, strategy: str, trace: Path):
    arguments = ["replay", sound, "--model", model, "--strategy", strategy, "--trace", trace, "-q"]
    return CliRunner().invoke(app, [str(each) for each in arguments])


@pytest.mark.parametrize(
    ("strategy", "needed"),
    [("expected", "expectation"), ("priority", "animphos"), ("naive", "animphos")],
)
def test_a_replay_reads_the_face_and_what_moves_it_and_nothing_else(
    shipped, sound, tmp_path, strategy, needed
):
    others = PARTS - {"face", needed}
    done = replay(
        sound, with_junk(shipped, tmp_path / "a.npz", *others), strategy, tmp_path / "trace"
    )
    assert done.exit_code == 0, done.output
    done = replay(
        sound, with_junk(shipped, tmp_path / "b.npz", needed), strategy, tmp_path / "none"
    )
    assert isinstance(done.exception, ModelError)
    assert "b.npz: damaged or not a lipservo model" in str(done.exception)


def test_evaluation_reads_the_baselines_too(shipped, tmp_path):
    for part in sorted(PARTS):
        with pytest.raises(ModelError, match="damaged or not a lipservo model"):
            load_trained_model(with_junk(shipped, tmp_path / "m.npz", part))


@pytest.fixture
def without_animphos(shipped, tmp_path) -> Path:
    """Write the model without its AnimPhos (recorded pieces of motion); return the path."""
    path = tmp_path / "m.npz"
    save_model(shipped, path)
    with zipfile.ZipFile(path) as archive:
        kept = [n for n in archive.namelist() if not n.startswith("animphos/")]
        members = {name: archive.read(name) for name in kept}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def test_a_model_without_animphos_is_refused_with_what_plays_it(without_animphos):
    face = load_face(without_animphos)
    make_synthesizer(face, MotionOptions(strategy="expected"), without_animphos)
    for strategy in ("animpho", "priority"):
        with pytest.raises(
            ModelError, match=r"lacks the AnimPhos .*strategy: expected.*`lipservo learn"
        ):
            make_synthesizer(face, MotionOptions(strategy=strategy), without_animphos)


@pytest.mark.parametrize(
    "typed", [("export", "{sound}", "-o", "{out}"), ("bench", "closures")], ids=" ".join
)
def test_commands_refuse_a_model_without_animphos_and_write_nothing(
    typed, without_animphos, tmp_path, sound
):
    out = tmp_path / "out.json"
    filled = [each.format(sound=sound, out=out) for each in typed]
    done = CliRunner().invoke(app, [*filled, "--model", str(without_animphos)])
    assert done.exit_code != 0
    assert re.search("(?i)animphos.*`lipservo learn face`", str(done.exception or done.output))
    assert not out.exists()


def test_a_file_that_was_replaced_between_two_readings_is_noticed(shipped, tmp_path):
    path = tmp_path / "m.npz"
    save_model(shipped, path)
    face = load_face(path)
    with np.load(path) as file:
        content = {key: file[key] for key in file.files}
    content["face/mean_mm"] = content["face/mean_mm"] + 1.0
    np.savez(path, **content)
    with pytest.raises(ModelError, match="was changed while it was read"):
        make_synthesizer(face, MotionOptions(), path)


@pytest.mark.parametrize("version", [1, 2, 3])
def test_older_files_are_refused_with_the_command_that_makes_them_anew(shipped, tmp_path, version):
    path = tmp_path / "old.npz"
    save_model(shipped, path)
    with np.load(path) as file:
        content = {key: file[key] for key in file.files}
    about = json.loads(content["about"].tobytes()) | {"version": version}
    content["about"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    np.savez(path, **content)
    with pytest.raises(
        UserError, match=rf"model version {version}, .*`lipservo learn face`"
    ) as refused:
        load_face(path)
    assert "\n" not in str(refused.value)


def test_weights_that_a_model_was_not_fitted_to_work_and_a_warning_says_so(caplog):
    make_synthesizer(load_face(), MotionOptions())
    assert not caplog.records
    make_synthesizer(load_face(), MotionOptions(weights="grid"))
    assert "was not fitted to the recogniser's weights grid" in caplog.text
    assert "lipservo learn soft" in caplog.text


def test_weights_adapted_from_those_of_the_map_are_no_others(tmp_path, caplog):
    """The map heard adapted weights too (docs/decisions/training-of-the-ears.md)."""
    weights, paths = load_shipped_weights(), [tmp_path / name for name in ("ours.npz", "new.npz")]
    for path, origin in zip(paths, (weights_digest("default"), "another"), strict=True):
        save_weights(weights, path, {ADAPTED_FROM: origin})
    make_synthesizer(load_face(), MotionOptions(weights=str(paths[0])))
    assert not caplog.records
    make_synthesizer(load_face(), MotionOptions(weights=str(paths[1])))
    assert "was not fitted to the recogniser's weights" in caplog.text


def test_a_map_that_names_no_weights_works_and_is_logged(shipped, tmp_path, caplog):
    path = tmp_path / "m.npz"
    save_model(replace(shipped, provenance={}), path)
    with np.load(path) as file:
        content = {key: file[key] for key in file.files}
    about = json.loads(content["about"].tobytes())
    del about["provenance"]
    content["about"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    np.savez(path, **content)
    with caplog.at_level("INFO", logger="lipservo"):
        make_synthesizer(load_face(path), MotionOptions(), path)
    assert "was not fitted to the recogniser's weights default" in caplog.text
