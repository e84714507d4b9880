import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.signal
import soundfile
from lipservo_lab.baselines.visible_error import visible_distances_mm
from lipservo_lab.corpus.alignment_cache import read_alignments
from lipservo_lab.evaluation.recognition.conditions import ConditionError, parse_condition
from lipservo_lab.learning.recognition import augmentation, noise
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipservo_lab.learning.recognition.training_data import (
    NO_TARGET,
    Taught,
    TrainingArray,
    TrainingError,
    TrainingPlan,
    delayed,
    feature_scale,
    training_arrays,
)
from small_network import random_weights
from speech import CLIP_PATH

from lipsync.output_file import OutputError
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF
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


def test_rooms_reach_from_beside_the_talker_to_more_reflected_than_direct_sound():
    """Direct sound from 8 dB above all reflected sound to 8 dB below it, in 50 rooms."""
    click = np.zeros(16_000, np.float32)
    click[0] = 1.0
    wet = [noise.reverberate(np.random.default_rng(seed), click) for seed in range(50)]
    direct_db = [-10.0 * np.log10(np.sum(each[1:] ** 2)) for each in wet]

    assert min(direct_db) < -8.0
    assert max(direct_db) > 8.0


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
    return list(training_arrays(clean, scale, (2, 7), n_heavy=1, seed=3)), scale


def test_the_same_seed_makes_the_same_arrays(clip, small_arrays):
    labels = np.random.default_rng(0).integers(0, len(PHONEMES), len(clip) // 160)
    clean = [LabelledSamples(clip, labels)] * 2
    again = list(training_arrays(clean, small_arrays[1], (2, 7), n_heavy=1, seed=3, n_processes=2))

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


class KilledError(Exception):
    """A run is killed."""


def killed(step):
    if step == 5:
        raise KilledError


@pytest.mark.parametrize("ends", [killed, lambda step: step == 3], ids=["killed", "stopped"])
def test_a_run_that_ends_early_goes_on_to_the_same_bits(
    training, plan, small_arrays, tmp_path, ends
):
    """Stopped between two lines of the log: what it says of the interval must be whole as well."""
    arrays, scale = small_arrays
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    whole.mkdir()
    parts.mkdir()
    expected = training.train_network(arrays, scale, plan, folder=whole)
    with pytest.raises((KilledError, training.TrainingStoppedError)) as ended:
        training.train_network(arrays, scale, plan, folder=parts, after_step=ends)
    if ends is not killed:
        assert "after step 3 of 6; " in str(ended.value)
        assert "--resume" in str(ended.value)
    resumed = training.train_network(arrays, scale, plan, folder=parts)

    assert np.array_equal(resumed.output, expected.output)
    assert np.array_equal(resumed.entry.kernel, expected.entry.kernel)
    assert np.array_equal(resumed.residuals[1].kernel, expected.residuals[1].kernel)
    log = (whole / "log.jsonl").read_text()
    assert (parts / "log.jsonl").read_text() == log
    assert [json.loads(record)["step"] for record in log.splitlines()] == [2, 4, 6]


def test_a_log_that_is_ahead_of_the_state_is_taken_back(training, plan, small_arrays, tmp_path):
    arrays, scale = small_arrays
    whole = training.train_network(arrays, scale, plan, folder=tmp_path)
    lines = (tmp_path / "log.jsonl").read_text()
    with (tmp_path / "log.jsonl").open("a") as log:
        log.write('{"step": 8, "loss": 1.0}\n{"step": 10, "lo')
    again = training.train_network(arrays, scale, plan, folder=tmp_path)

    assert np.array_equal(again.output, whole.output)
    assert (tmp_path / "log.jsonl").read_text() == lines


def half(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("change", "other", "told"),
    [
        (lambda _path: None, {"channels": 16}, "another run: channels was 8, now 16"),
        (lambda _path: None, {"seed": 4}, "another run: seed was 0, now 4"),
        (half, {}, "damaged or no state; delete it"),
        (lambda path: path.write_bytes(b""), {}, "damaged or no state; delete it"),
        (lambda path: path.write_text("no state\n"), {}, "state"),
    ],
)
def test_a_state_that_does_not_fit_is_refused_in_one_line_and_kept(
    training, plan, small_arrays, tmp_path, change, other, told
):
    arrays, scale = small_arrays
    training.train_network(arrays, scale, replace(plan, n_steps=2), folder=tmp_path)
    plan = replace(plan, n_steps=2, **other)
    change(tmp_path / "state.pt")
    kept = (tmp_path / "state.pt").read_bytes()
    with pytest.raises(TrainingError, match=told) as raised:
        training.train_network(arrays, scale, plan, folder=tmp_path)

    assert "\n" not in str(raised.value)
    assert (tmp_path / "state.pt").read_bytes() == kept


def test_a_state_of_another_corpus_is_refused(training, plan, small_arrays, tmp_path):
    arrays, scale = small_arrays
    training.train_network(arrays, scale, replace(plan, n_steps=2), folder=tmp_path)
    others = [replace(each, features=each.features + np.float16(1)) for each in arrays]
    with pytest.raises(TrainingError, match="of another run: corpus was"):
        training.train_network(others, scale, replace(plan, n_steps=2), folder=tmp_path)


def test_a_disk_that_fills_leaves_the_last_state(
    training, plan, small_arrays, tmp_path, monkeypatch
):
    arrays, scale = small_arrays
    with pytest.raises(training.TrainingStoppedError):
        training.train_network(arrays, scale, plan, folder=tmp_path, after_step=lambda _step: True)
    kept = (tmp_path / "state.pt").read_bytes()
    write = Path.write_bytes

    def full(path, content):
        write(path, content[: len(content) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", full)
        with pytest.raises(OutputError, match=r"state\.pt.*[Nn]o space"):
            training.train_network(arrays, scale, plan, folder=tmp_path)
    assert (tmp_path / "state.pt").read_bytes() == kept
    assert not list(tmp_path.glob("*.partial"))
    training.train_network(arrays, scale, plan, folder=tmp_path)


def test_a_state_of_the_default_network_has_at_most_12_mb(training, plan, small_arrays, tmp_path):
    arrays, scale = small_arrays
    one_step = replace(plan, channels=192, dilations=TrainingPlan().dilations, n_steps=1)
    training.train_network(arrays, scale, one_step, folder=tmp_path)

    assert (tmp_path / "state.pt").stat().st_size <= 12e6


def test_the_weights_with_the_best_score_are_returned(training, plan, small_arrays, tmp_path):
    arrays, scale = small_arrays
    seen = {}

    def check(step, weights):
        seen[step] = weights.output
        return {"score": {2: 0.1, 4: 0.3, 6: 0.2}[step]}

    best = training.train_network(arrays, scale, plan, folder=tmp_path, check=check)

    assert np.abs(best.output - seen[4]).max() < 1e-3
    assert np.abs(best.output - seen[6]).max() > 0.0


def one_phone(said, sure):
    """Logits (1, 1 head, 40, 1) that are nearly sure of a phone."""
    import torch

    logits = torch.zeros(1, 1, len(PHONEMES), 1)
    logits[0, 0, PHONEMES.index(said), 0] = sure
    return logits


def test_the_visible_term_costs_what_is_seen(training, plan):
    """AA for P is 8.5 mm of gap, F for P 1.4; a K for a T nobody sees."""
    import torch

    plain = replace(plan, delays=(2,), head_weights=(1.0,))
    seen = replace(plain, visible_weight=1.0)

    def costs_mm(said, heard):
        target = torch.tensor([[[PHONEMES.index(said)]]])
        logits = one_phone(heard, 20.0)
        with_term = training.training_loss(logits, target, seen)
        return float(with_term - training.training_loss(logits, target, plain))

    distances = visible_distances_mm()
    for said, heard in (("P", "AA"), ("P", "F"), ("T", "K"), ("UW", "IY"), ("N", "SIL")):
        expected_mm = distances[VISEME_OF[said], VISEME_OF[heard]]
        assert costs_mm(said, heard) == pytest.approx(expected_mm, abs=1e-3)
    assert costs_mm("P", "B") == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("shape", "most_off"),
    [({}, 1e-3), ({"channels": 12, "dilations": (1, 2, 4)}, 0.02)],
    ids=["the same", "grown"],
)
def test_a_network_started_from_weights_says_what_they_say_and_can_learn(
    torch_network, training, plan, small_arrays, tmp_path, shape, most_off
):
    arrays, scale = small_arrays
    small = random_weights(n_channels=8, dilations=(1, 2), delays=(2, 7))
    small, plan = replace(small, scale=scale), replace(plan, **shape)
    weights = torch_network.exported(torch_network.started_from(small, arrays, plan), scale, plan)
    features = arrays[0].features[:80].astype(np.float32)
    expected = StreamingNetwork(small).push(features)

    assert len(weights.entry.bias) == plan.channels
    assert np.abs(StreamingNetwork(weights).push(features) - expected).max() < most_off
    learned = training.train_network(arrays, scale, plan, folder=tmp_path, start=small)
    assert np.abs(learned.residuals[-1].kernel - weights.residuals[-1].kernel).max() > 1e-4


def test_taught_frames_keep_their_labels_and_posteriors_in_every_copy(
    training, plan, clip, small_arrays, tmp_path
):
    """A teacher that is sure of the labels teaches what the labels say, by codes through copies."""
    _, scale = small_arrays
    labels = np.random.default_rng(0).integers(0, len(PHONEMES), len(clip) // 160)
    clean = [LabelledSamples(clip, labels)] * 2
    sure = np.eye(len(PHONEMES), dtype=np.float16)
    taught = Taught(np.tile(labels, 2), sure[np.tile(labels, 2)])
    plain = list(training_arrays(clean, scale, (2, 7), n_heavy=1, seed=3))
    coded = list(training_arrays(clean, scale, (2, 7), n_heavy=1, seed=3, is_taught=True))

    for one, other in zip(plain, coded, strict=True):
        is_coded = other.targets >= len(PHONEMES)
        rows = other.targets[is_coded] - len(PHONEMES)
        assert np.array_equal(taught.labels[rows], one.targets[is_coded])
        assert np.array_equal(other.targets[~is_coded], one.targets[~is_coded])
        assert is_coded.mean() > 0.5
    folders = [tmp_path / name for name in ("plain", "taught")]
    for folder in folders:
        folder.mkdir()
    by_labels = training.train_network(plain, scale, plan, folder=folders[0])
    by_teacher = training.train_network(coded, scale, plan, folder=folders[1], taught=taught)
    assert np.abs(by_labels.output - by_teacher.output).max() < 1e-4


def test_learning_lowers_the_loss(training, plan, small_arrays, tmp_path):
    arrays, scale = small_arrays
    longer = replace(plan, n_steps=40, log_every=10, check_every=40)
    training.train_network(arrays, scale, longer, folder=tmp_path)
    log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]

    assert log[-1]["loss"] < log[0]["loss"]


def test_weights_of_another_shape_are_no_start(torch_network, plan, small_arrays):
    with pytest.raises(TrainingError, match="do not fit: a network may only"):
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
def test_each_corpus_counts_alike_in_the_score_however_long_it_is(plan, small_arrays):
    from lipservo_lab.learning.recognition.training_run import checked

    arrays, scale = small_arrays
    weights = random_weights(n_channels=8, dilations=(1, 2), delays=(2, 7))
    long, short = arrays[0], TrainingArray(arrays[0].features[:90], arrays[0].targets[:90])
    conditions = {"clean": long, "corpus_long": long, "corpus_short": short}
    found = checked(replace(weights, scale=scale), conditions, plan)
    each = [found[f"corpus_{name}_delay2_viseme_speech"] for name in ("long", "short")]

    assert each[0] != each[1]
    assert found["score"] == pytest.approx(sum(each) / 2)
    assert "score" not in checked(weights, {"clean": long}, plan)


@pytest.mark.usefixtures("training")
def test_a_folder_that_holds_a_run_is_not_taken_up_unless_that_is_asked_for(
    plan, speaker, tmp_path
):
    from lipservo_lab.learning.recognition.training_run import TrainingRun, run_training

    (tmp_path / "state.pt").write_bytes(b"of another run")
    with pytest.raises(TrainingError, match="holds a run already; go on with --resume"):
        run_training(TrainingRun((speaker,), tmp_path, plan=plan), lambda *_: None)
    assert (tmp_path / "state.pt").read_bytes() == b"of another run"


@pytest.mark.usefixtures("training")
def test_a_name_in_two_corpora_is_refused(plan, speaker, tmp_path):
    from lipservo_lab.learning.recognition.training_run import TrainingRun, run_training

    with pytest.raises(TrainingError, match="'one' is in two corpora"):
        run_training(TrainingRun((speaker, speaker), tmp_path, plan=plan), lambda *_: None)
