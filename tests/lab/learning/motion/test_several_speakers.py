"""Several speakers on one face: known deformations are undone, weights count, names are told."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import Corpus, CorpusError, Utterance
from lipservo_lab.evaluation.motion.motion_scores import seen_in_training
from lipservo_lab.learning.motion.face_training import TrainingError, train
from lipservo_lab.learning.motion.several_speakers import on_one_face
from lipservo_lab.learning.motion.trained_model import load_trained_model
from scipy.spatial.transform import Rotation
from small_corpus import write_corpus
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.markers import MARKERS_47
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent

PHONE_S = 0.16
SOUNDS = tuple(p for p in PHONEMES if p != SILENCE)


def speaker(name, *, n_sentences=12, seed=0, shape=lambda markers_mm: markers_mm, rate_hz=25.0):
    """Made up of the shipped model: sentences of ten phonemes between silences.

    shape: turns markers (n, 47, 3) into others.
    """
    model = load_trained_model()
    rng = np.random.default_rng(seed)
    utterances = []
    for number in range(n_sentences):
        said = [SILENCE, SILENCE, *rng.permutation(SOUNDS)[:10], SILENCE, SILENCE]
        times_s = np.arange(len(said)) * PHONE_S
        faces = np.array(
            [model.rest if p == SILENCE else model.baselines.centres[PHONEMES.index(p)]
             for p in said]
        )  # fmt: skip
        frames_s = np.arange(0.0, len(said) * PHONE_S, 1.0 / rate_hz)
        motion = np.stack([np.interp(frames_s, times_s + PHONE_S / 2, c) for c in faces.T], axis=1)
        phones = tuple(
            PhonemeEvent(p, t, t + PHONE_S) for p, t in zip(said, times_s.tolist(), strict=True)
        )
        markers_mm = shape(model.markers_mm(motion)).astype(np.float32)
        utterances.append(
            Utterance(f"u{number}", markers_mm, rate_hz, Path(f"{name}-{number}.flac"), phones, ())
        )
    return Corpus(name, MARKERS_47, tuple(utterances), model.head_reference_mm)


FIRST = speaker("first")
#: Of a mouth on another face, after its own motion was brought to this one.
MOST_MM, MOST_OF_OTHER_TEXT_MM = 0.05, 0.3


def deformed(angles_deg, scales, offset_mm=0.0):
    """Stretched along its axes, with a longer chin, turned and moved."""
    rotation = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    chins = [name.startswith("chin") for name in FIRST.layout.names]
    middle = FIRST.utterances[0].markers_mm[0].mean(axis=0)

    def shape(markers_mm):
        stretched = (markers_mm - middle) * scales
        stretched[:, chins, 1] -= offset_mm
        return stretched @ rotation.T + [5.0, -3.0, 8.0]

    return shape


def error_mm(corpus, original):
    """RMS distance of the second speaker's markers from what the first face would have done."""
    ours = {u.name.removeprefix("second/"): u.markers_mm for u in corpus.utterances}
    apart = [ours[u.name] - u.markers_mm for u in original.utterances]
    return float(np.sqrt((np.concatenate(apart) ** 2).sum(axis=2).mean()))


@settings(max_examples=15)
@given(
    angles_deg=st.tuples(*[st.floats(-25, 25)] * 3), scales=st.tuples(*[st.floats(0.6, 1.6)] * 3)
)
def test_a_deformed_speaker_moves_as_the_original(angles_deg, scales):
    second = speaker("second", shape=deformed(angles_deg, scales))
    corpus, maps = on_one_face([FIRST, second])
    assert error_mm(corpus, FIRST) < MOST_MM
    np.testing.assert_allclose(maps["second"].scale, 1.0 / np.array(scales), rtol=1e-3)


def test_other_text_and_a_longer_chin_cost_little():
    other = speaker("second", seed=1, n_sentences=40)
    second = speaker(
        "second", seed=1, n_sentences=40, shape=deformed((8, -5, 3), (1.15, 0.8, 1.3), 5.0)
    )
    corpus, _ = on_one_face([FIRST, second])
    assert error_mm(corpus, other) < MOST_OF_OTHER_TEXT_MM


def test_the_face_is_the_first_speakers_unless_another_is_named():
    second = speaker("second", shape=deformed((5, 0, 0), (1.2, 0.9, 1.0)), rate_hz=30.0)
    corpus, maps = on_one_face([FIRST, second])
    assert [u.frame_rate_hz for u in corpus.utterances] == [25.0] * 24
    assert corpus.utterances[0].name == "first/u0"
    np.testing.assert_array_equal(corpus.utterances[0].markers_mm, FIRST.utterances[0].markers_mm)
    corpus, maps = on_one_face([FIRST, second], face_of="second")
    assert set(maps) == {"first"}
    assert {u.frame_rate_hz for u in corpus.utterances} == {30.0}
    np.testing.assert_array_equal(corpus.utterances[12].markers_mm, second.utterances[0].markers_mm)


def test_a_lone_speaker_keeps_names():
    corpus, maps = on_one_face([FIRST])
    assert (corpus.utterances[0].name, maps) == ("u0", {})


@pytest.mark.parametrize(
    ("others", "options", "complaint"),
    [
        ([FIRST], {}, "2 corpora are called 'first'; rename"),
        ([speaker("second")], {"face_of": "third"}, "no corpus is called 'third'"),
        ([speaker("second")], {"weights": {"me": 0.5}}, "use one of first, second"),
        ([speaker("second")], {"weights": {"first": 0.0}}, "--weight first=0"),
        ([speaker("second", n_sentences=1)], {}, "second beside first: only 0 phonemes are said"),
        (
            [speaker("second", shape=lambda m: m * [1, 0.01, 1])],
            {},
            "along y; more than 4 times",
        ),
        ([FIRST.keep(set())], {}, "2 corpora are called"),
        (
            [replace(FIRST.keep(set()), name="second")],
            {},
            "second: no sentence has a tier `phones`",
        ),
    ],
)
def test_speakers_that_cannot_be_joined_are_refused(others, options, complaint):
    with pytest.raises(CorpusError, match=complaint):
        on_one_face([FIRST, *others], **options)


def test_a_speaker_with_fewer_frames_than_components_is_named():
    short = speaker("second")
    corpus, _ = on_one_face([FIRST, short])
    cut = [
        replace(u, markers_mm=u.markers_mm[:3], phones=u.phones[:1])
        if u.name.startswith("second/") else u
        for u in corpus.utterances[:14]
    ]  # fmt: skip
    with pytest.raises(
        TrainingError, match="corpus second: 6 frames are too few for --components 8"
    ):
        train(replace(corpus, utterances=tuple(cut)))


def test_everything_learned_counts_frames_by_their_weight():
    """Two speakers of one face, of whom one has the lower lip 8 mm lower."""

    def opened(markers_mm):
        more = markers_mm.copy()
        more[:, FIRST.layout.lower_lip, 1] -= 8.0
        return more

    second = speaker("second", shape=opened)
    said = [
        FIRST.utterances[0],
        *(replace(u, name=f"x{u.name}", weight=2.5) for u in second.utterances[:2]),
    ]
    model = train(replace(FIRST, utterances=tuple(said)))
    weights = np.repeat([1.0, 2.5, 2.5], [len(u.markers_mm) for u in said])
    expected = np.average(np.concatenate([u.markers_mm for u in said]), axis=0, weights=weights)
    np.testing.assert_allclose(model.mean_mm, expected, atol=1e-3)
    assert model.baselines.counts.sum() == pytest.approx((1 + 2.5 + 2.5) * 14)


def test_the_command_joins_folders(tmp_path):
    one, two = write_corpus(tmp_path / "one", 6), write_corpus(tmp_path / "two", 4, seed=0)
    model, arguments = tmp_path / "m.npz", ["--phonemes", "true", "--json", "-q"]
    done = CliRunner().invoke(
        app,
        ["learn", "face", str(one), str(two), "-o", str(model), "--weight", "two=0.5", *arguments],
    )
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["corpus"] == "one+two"
    assert told["sentences"] == 10
    assert told["speakers"]["two"]["weight"] == 0.5
    assert len(told["speakers"]["two"]["scale_xyz"]) == 3
    # Sentences that it has learned from are known by their names in their own folders.
    trained = load_trained_model(model)
    assert len(seen_in_training(trained, read_grid(one).utterances)) == 6
    for wrong in ("two", "two=much", "=2"):
        refused = CliRunner().invoke(
            app,
            ["learn", "face", str(one), str(two), "-o", str(model), "--weight", wrong, *arguments],
        )
        assert refused.exit_code == 2
        assert "write NAME=W" in refused.output + str(refused.exception)
