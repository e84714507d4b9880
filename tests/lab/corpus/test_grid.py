"""The reader of grid_s1 folders and the removal of head motion."""

from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import CorpusError
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation
from small_corpus import write_corpus

from lipsync.face.head_motion import apply_similarity, fit_similarity, refine_mean
from lipsync.markers import MARKERS_47


def moved(points: np.ndarray, n_frames: int, rng: np.random.Generator) -> np.ndarray:
    """The same points under random similarities."""
    rotation = Rotation.random(n_frames, random_state=4).as_matrix()
    scale = rng.uniform(0.5, 2.0, (n_frames, 1, 1))
    return scale * np.einsum("fij,pj->fpi", rotation, points) + rng.normal(0, 50, (n_frames, 1, 3))


def test_a_known_similarity_is_undone_exactly():
    rng = np.random.default_rng(0)
    reference = rng.normal(0, 30, (24, 3))
    frames = moved(reference, 20, rng)
    back = apply_similarity(frames, *fit_similarity(frames, reference))
    np.testing.assert_allclose(back, np.broadcast_to(reference, back.shape), atol=1e-9)


def test_the_residual_of_a_noisy_fit_is_that_of_scipy_procrustes():
    rng = np.random.default_rng(1)
    reference = rng.normal(0, 30, (12, 3))
    frame = moved(reference, 1, rng) + rng.normal(0, 2.0, (1, 12, 3))
    fitted = apply_similarity(frame, *fit_similarity(frame, reference))[0]
    centred = reference - reference.mean(axis=0)
    ours = ((fitted - reference) ** 2).sum() / (centred**2).sum()
    assert ours == pytest.approx(procrustes(reference, frame[0])[2])


def test_a_mirrored_head_is_not_mirrored_back():
    reference = np.random.default_rng(2).normal(0, 30, (8, 3))
    frames = (reference * [-1.0, 1.0, 1.0])[None]
    _, rotation, _ = fit_similarity(frames, reference)
    assert np.linalg.det(rotation[0]) == pytest.approx(1.0)


def test_the_refined_mean_is_one_head_whatever_the_frames_did():
    rng = np.random.default_rng(3)
    head = rng.normal(0, 30, (24, 3))
    mean = refine_mean(moved(head, 50, rng), (0, 1, 90.0))
    assert np.linalg.norm(mean[0] - mean[1]) == pytest.approx(90.0)
    assert procrustes(head, mean)[2] < 1e-12


def test_a_folder_is_read_in_millimetres_without_head_motion(tmp_path):
    corpus = read_grid(write_corpus(tmp_path / "c", 3))
    assert [u.name for u in corpus.utterances] == ["s0", "s1", "s2"]
    assert corpus.layout == MARKERS_47
    first = corpus.utterances[0]
    assert first.markers_mm.shape == (30, 47, 3)
    assert [p.phoneme for p in first.phones] == ["SIL", "B", "AA", "T", "UW", "SIL"]
    assert [w.text for w in first.words] == ["word"]
    still = MARKERS_47.names.index("nose_2")
    assert np.ptp(first.markers_mm[:, still], axis=0).max() < 3.0, "noise only, no turning"
    eyes = corpus.head_reference_mm[:2]
    assert np.linalg.norm(eyes[0] - eyes[1]) == pytest.approx(90.0)


def test_another_folder_can_be_laid_on_the_same_head(tmp_path):
    corpus = read_grid(write_corpus(tmp_path / "c", 2))
    again = read_grid(tmp_path / "c", head_reference_mm=corpus.head_reference_mm)
    np.testing.assert_array_equal(corpus.utterances[1].markers_mm, again.utterances[1].markers_mm)


def test_a_head_of_other_rigid_points_is_refused(tmp_path):
    with pytest.raises(CorpusError, match="6 rigid points, and the model's head has 24; name the"):
        read_grid(write_corpus(tmp_path / "c", 2), head_reference_mm=np.zeros((24, 3)))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda c: (c / "landmarks" / "s1.npz").unlink(), "s1.npz: no such file"),
        (
            lambda c: (c / "landmarks" / "s1.npz").write_bytes(b"PK"),
            "s1.npz: not a file of landmarks",
        ),
        (lambda c: (c / "audio" / "s1.flac").unlink(), "s1.flac: missing or not a sound file"),
        (lambda c: (c / "audio" / "s1.flac").write_bytes(b"x"), "s1.flac: missing or not a sound"),
        (lambda c: (c / "labels" / "s1.TextGrid").unlink(), "s1.TextGrid: no such file"),
        (
            lambda c: replace_text(c, '"AA"', '"QQ"'),
            "phoneme 2 at .*: 'QQ' is neither ARPA",
        ),
        (lambda c: save_landmarks(c, np.zeros((30, 5, 3))), r"shape \(30, 5, 3\); expected"),
        (lambda c: save_landmarks(c, np.full((30, 53, 3), np.nan)), "not numbers"),
        (lambda c: save_landmarks(c, np.zeros((90, 53, 3))), "sound 1.20 s, landmarks 3.60 s"),
    ],
)
def test_a_bad_sentence_is_named_or_skipped_and_listed(tmp_path, damage, said):
    folder = write_corpus(tmp_path / "c", 3)
    damage(folder)
    with pytest.raises(CorpusError, match=said):
        read_grid(folder)
    corpus = read_grid(folder, skip_bad=True)
    assert [u.name for u in corpus.utterances] == ["s0", "s2"]
    assert len(corpus.skipped) == 1


def replace_text(folder: Path, old: str, new: str) -> None:
    path = folder / "labels" / "s1.TextGrid"
    path.write_text(path.read_text().replace(old, new))


def save_landmarks(folder: Path, points: np.ndarray) -> None:
    np.savez(folder / "landmarks" / "s1.npz", landmarks_64th_px=points)


def test_a_folder_that_is_no_corpus_says_what_one_holds(tmp_path):
    with pytest.raises(CorpusError, match=r"landmarks.json: no such file; a corpus folder holds"):
        read_grid(tmp_path)


def test_sentences_without_a_phones_tier_are_kept_but_not_labelled(tmp_path):
    folder = write_corpus(tmp_path / "c", 3)
    replace_text(folder, 'name = "phones"', 'name = "other"')
    corpus = read_grid(folder)
    assert len(corpus.utterances) == 3
    assert [u.name for u in corpus.labelled().utterances] == ["s0", "s2"]


@pytest.mark.slow
def test_the_real_corpus_is_read(corpus_dir):
    corpus = read_grid(corpus_dir / "grid_s1")
    assert len(corpus.utterances) == 890
    assert len(corpus.labelled().utterances) == 825
    first = corpus.utterances[0]
    assert first.markers_mm.shape == (75, 47, 3)
    lips = first.markers_mm[:, MARKERS_47.names.index("outer_lip_61")]
    assert np.ptp(lips[:, 0]) < 15.0, "a mouth corner moves by millimetres, not with the head"
