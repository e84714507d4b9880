import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
import soundfile
from lipservo_lab.corpus.alignment_cache import read_alignments
from lipservo_lab.evaluation.recognition.conditions import ConditionError, parse_condition
from lipservo_lab.learning.recognition import augmentation, noise
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipservo_lab.learning.recognition.training_data import (
    NO_TARGET,
    TrainingError,
    TrainingPlan,
    delayed,
    feature_scale,
    training_arrays,
)
from small_network import random_weights
from speech import CLIP_PATH

from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.network import StreamingNetwork
from lipsync.textgrid import write_tiers

RATE_HZ = 16_000


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0][: 3 * RATE_HZ]


def level_db(samples):
    return 10 * np.log10(np.mean(np.square(samples, dtype=np.float64)))


@pytest.mark.parametrize("kind", ["white", "music", "babble"])
def test_noise_lies_as_far_below_the_speech_as_was_asked(clip, kind):
    noisy = parse_condition(f"{kind}:10").apply(clip, "an utterance", [clip[::-1], clip])

    assert level_db(noisy - clip) == pytest.approx(level_db(clip) - 10.0, abs=0.01)
    again = parse_condition(f"{kind}:10").apply(clip, "an utterance", [clip[::-1], clip])
    assert np.array_equal(noisy, again)
    other = parse_condition(f"{kind}:10").apply(clip, "another", [clip[::-1], clip])
    assert not np.array_equal(noisy, other)


def test_level_changes_the_level_alone(clip):
    quiet = parse_condition("level:-30").apply(clip, "", [])

    assert level_db(quiet) == pytest.approx(level_db(clip) - 30.0, abs=0.01)


@pytest.mark.parametrize("text", ["white", "grey:10", "white:loud", ""])
def test_an_unknown_condition_is_explained(text):
    with pytest.raises(ConditionError, match="is not KIND:DB; kinds: white"):
        parse_condition(text)


def test_a_telephone_passes_1_khz_and_stops_6_khz():
    time_s = np.arange(RATE_HZ) / RATE_HZ
    for hz, change_db in ((1_000, 0.0), (6_000, -60.0)):
        tone = (0.5 * np.sin(2 * np.pi * hz * time_s)).astype(np.float32)
        change = level_db(noise.telephone(tone)) - level_db(tone)
        assert change == pytest.approx(0.0, abs=0.5) if change_db == 0.0 else change < -30.0


def test_a_room_keeps_the_onset_where_it_was():
    click = np.zeros(8_000, np.float32)
    click[1_000] = 1.0
    wet = noise.reverberate(np.random.default_rng(0), click)

    assert np.abs(wet[:1_000]).max() < 1e-4
    assert wet[1_000] == pytest.approx(1.0, abs=1e-4)
    assert np.abs(wet[1_001:]).max() > 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_a_codec_changes_speech_without_moving_it(clip, seed):
    changed = noise.lossy(np.random.default_rng(seed), clip)

    lags = scipy.signal.correlation_lags(len(changed), len(clip))
    assert lags[scipy.signal.correlate(changed, clip).argmax()] == 0
    assert 3.0 < level_db(clip) - level_db(changed - clip) < 40.0


def test_labels_stay_with_their_sound_at_another_speed():
    """A second of silence, then a tone: wherever the change goes, the label changes with it."""
    samples = np.zeros(2 * RATE_HZ, np.float32)
    samples[RATE_HZ:] = 0.3 * np.sin(np.arange(RATE_HZ) * 0.5)
    labels = np.repeat([PHONEMES.index(SILENCE), PHONEMES.index("AA")], 100)
    for seed in range(8):
        heard = augmentation._at_speed(
            np.random.default_rng(seed), LabelledSamples(samples, labels)
        )
        onset_s = np.flatnonzero(np.abs(heard.samples) > 0.05)[0] / RATE_HZ
        assert np.flatnonzero(np.diff(heard.labels))[0] / 100 == pytest.approx(onset_s, abs=0.02)


def test_a_head_learns_the_label_of_as_many_frames_ago_as_it_waits():
    targets = delayed(np.array([5, 6, 7]), 5, (0, 2))

    assert targets[:, 0].tolist() == [5, 6, 7, NO_TARGET, NO_TARGET]
    assert targets[:, 1].tolist() == [NO_TARGET, NO_TARGET, 5, 6, 7]


@pytest.fixture(scope="module")
def small_arrays(clip):
    labels = np.random.default_rng(0).integers(0, len(PHONEMES), len(clip) // 160)
    clean = [LabelledSamples(clip, labels)] * 2
    scale = feature_scale(clean)
    return training_arrays(clean, scale, (2, 7), n_heavy=1, seed=3), scale


def test_the_same_seed_makes_the_same_arrays(clip, small_arrays):
    labels = np.random.default_rng(0).integers(0, len(PHONEMES), len(clip) // 160)
    clean = [LabelledSamples(clip, labels)] * 2
    again = training_arrays(clean, small_arrays[1], (2, 7), n_heavy=1, seed=3, n_processes=2)

    for first, second in zip(small_arrays[0], again, strict=True):
        assert np.array_equal(first.features, second.features)
        assert np.array_equal(first.targets, second.targets)


@pytest.fixture(scope="module")
def training():
    pytest.importorskip("torch", reason="training needs the extra `train`")
    from lipservo_lab.learning.recognition import network_training

    return network_training


@pytest.fixture(scope="module")
def torch_network():
    pytest.importorskip("torch", reason="training needs the extra `train`")
    from lipservo_lab.learning.recognition import torch_network

    return torch_network


@pytest.fixture(scope="module")
def plan():
    return TrainingPlan(
        delays=(2, 7),
        head_weights=(0.5, 0.5),
        dilations=(1, 2),
        channels=8,
        n_steps=6,
        batch=2,
        window=50,
        log_every=2,
        check_every=2,
        n_threads=1,
    )


def test_the_exported_weights_say_what_torch_says(torch_network, plan, small_arrays):
    import torch

    torch.manual_seed(1)
    network = torch_network.TorchNetwork(plan)
    features = small_arrays[0][0].features[:80].astype(np.float32)
    batch = torch.from_numpy(features.T[None])
    network.train()
    network(batch)  # so that the norms have seen something
    network.eval()
    with torch.no_grad():
        expected = torch.softmax(network(batch)[0], dim=1).permute(2, 0, 1).numpy()
    weights = torch_network.exported(network, small_arrays[1], plan)

    assert np.abs(StreamingNetwork(weights).push(features) - expected).max() < 1e-5


def test_a_run_that_was_interrupted_ends_with_the_same_weights(
    training, plan, small_arrays, tmp_path
):
    arrays, scale = small_arrays
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    whole.mkdir()
    parts.mkdir()

    class KilledError(Exception):
        pass

    def kill(step):
        if step == 5:
            raise KilledError

    expected = training.train_network(arrays, scale, plan, folder=whole)
    with pytest.raises(KilledError):
        training.train_network(arrays, scale, plan, folder=parts, progress=kill)
    resumed = training.train_network(arrays, scale, plan, folder=parts)

    assert np.array_equal(resumed.output, expected.output)
    assert np.array_equal(resumed.residuals[1].kernel, expected.residuals[1].kernel)
    log = [json.loads(line) for line in (whole / "log.jsonl").read_text().splitlines()]
    assert [record["step"] for record in log] == [2, 4, 6]


def test_learning_lowers_the_loss(training, plan, small_arrays, tmp_path):
    arrays, scale = small_arrays
    longer = replace(plan, n_steps=40, log_every=10, check_every=40)
    training.train_network(arrays, scale, longer, folder=tmp_path)
    log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]

    assert log[-1]["loss"] < log[0]["loss"]


def test_a_network_started_from_weights_says_what_they_say(torch_network, plan, small_arrays):
    arrays, scale = small_arrays
    weights = random_weights(n_channels=8, dilations=(1, 2), delays=(2, 7))
    weights = replace(weights, scale=scale)
    network = torch_network.started_from(weights, arrays, plan)
    again = torch_network.exported(network, scale, plan)
    features = arrays[0].features[:80].astype(np.float32)

    expected = StreamingNetwork(weights).push(features)
    assert np.abs(StreamingNetwork(again).push(features) - expected).max() < 1e-3


def test_weights_of_another_shape_are_no_start(torch_network, plan, small_arrays):
    with pytest.raises(TrainingError, match="another shape"):
        torch_network.started_from(random_weights(n_channels=16), small_arrays[0], plan)


@pytest.fixture(scope="module")
def speaker(tmp_path_factory, clip):
    """Two labelled sentences in the layout of grid_s1."""
    folder = tmp_path_factory.mktemp("speaker")
    tiers = {"words": (("hello", 0.5, 2.5),), "phones": (("SIL", 0.0, 0.5), ("AA", 0.5, 3.0))}
    for name in ("audio", "labels"):
        (folder / name).mkdir()
    for name in ("one", "two"):
        soundfile.write(folder / "audio" / f"{name}.flac", clip, RATE_HZ)
        write_tiers(folder / "labels" / f"{name}.TextGrid", tiers)
    return folder


@pytest.mark.usefixtures("training")
def test_what_is_left_out_is_not_even_read(plan, speaker, tmp_path):
    from lipservo_lab.learning.recognition.training_run import TrainingRun, run_training

    (speaker / "audio" / "two.flac").write_bytes(b"no sound")
    run = TrainingRun((speaker,), tmp_path, left_out=frozenset({"two"}), n_copies=1, plan=plan)
    weights = run_training(run, lambda *_: None)

    assert weights.delays == plan.delays
    assert list(read_alignments(tmp_path / "alignments.jsonl")) == ["one"]


@pytest.mark.usefixtures("training")
def test_a_name_in_two_corpora_is_refused(plan, speaker, tmp_path):
    from lipservo_lab.learning.recognition.training_run import TrainingRun, run_training

    with pytest.raises(TrainingError, match="'one' is in the corpora twice"):
        run_training(TrainingRun((speaker, speaker), tmp_path, plan=plan), lambda *_: None)
