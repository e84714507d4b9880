"""Good and bad clips of one folder: what becomes of each, and the corpus that is written."""

import json
import shutil

import numpy as np
import pytest

pytest.importorskip("av", reason="video needs PyAV, the extra `video`")

import soundfile
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.video.face_track import tracked_gaps_mm
from lipservo_lab.video.video_clips import find_clips
from lipservo_lab.video.video_import import check_corpus_folder, import_videos, write_corpus
from pixel_video import PixelFace, PixelTracker
from talking_pixels import TEXT, even_times_s, gaps_mm, speech, write_clip, write_pictures

from lipsync.output_file import OutputError
from lipsync.video.video_file import VideoError


def quietly(_what, _n_done, _n_all):
    """Nobody watches."""


def uneven_times_s():
    """As a telephone films: 24 to 40 pictures a second."""
    steps_s = np.random.default_rng(1).uniform(0.025, 0.042, 500)
    times_s = np.concatenate(([0.0], np.cumsum(steps_s)))
    return times_s[times_s < len(speech()) / 16_000]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("clips")
    for name in ("good", "second"):
        write_clip(made / f"{name}.mkv")
    (made / "good.txt").write_text(TEXT)
    write_clip(made / "late.mkv", sound_late_s=0.2)
    write_clip(made / "elsewhere.mkv", sound_late_s=1.2)
    write_clip(made / "uneven.mkv", uneven_times_s())
    write_clip(made / "away.mkv", yaw_deg=50)
    write_clip(made / "mute.mkv", with_sound=False)
    write_clip(made / "small.mkv", width_px=30)
    write_clip(made / "slow.mkv", even_times_s()[::3])
    write_pictures(made / "nobody.mkv")
    write_pictures(made / "two.mkv", PixelFace(5), PixelFace(5, left_px=110))
    write_pictures(made / "still.mkv", PixelFace(5))
    (made / "broken.mkv").write_bytes(b"no video at all")
    shutil.copy(made / "good.mkv", made / "untrue.mkv")
    (made / "transcripts.txt").write_text(
        "untrue seventeen yellow elephants are quietly painting the enormous cathedral roof\n"
    )
    return made


@pytest.fixture(scope="module")
def imported(folder):
    return import_videos(find_clips(folder), PixelTracker(), quietly)


@pytest.fixture(scope="module")
def reports(imported):
    return {report.clip: report for report in imported.reports}


def test_good_clips_become_sentences_and_every_clip_is_reported(imported, reports, folder):
    assert [s.name for s in imported.sentences] == ["good", "late", "second", "uneven"]
    assert set(reports) == {path.stem for path in folder.glob("*.mkv")}
    assert imported.rate_hz == 25.0


@pytest.mark.parametrize(
    ("clip", "reason"),
    [
        ("away", "turned away in"),
        ("mute", "has no sound"),
        ("small", "the face is too small: 22 pixels"),
        ("slow", "8.3 pictures a second"),
        ("nobody", "no face in any picture"),
        ("two", "two faces in"),
        ("still", "the lips do not follow the sound"),
        ("elsewhere", "the lips do not follow the sound"),
        ("broken", "cannot be read as video"),
        ("untrue", "the text"),
    ],
)
def test_what_cannot_be_used_is_left_out_with_the_reason(reports, clip, reason):
    assert reason in reports[clip].left_out


def test_a_clip_is_judged_by_where_its_sound_will_be_and_not_by_a_lucky_shift(reports):
    """The sound, moved by more than is looked for, agrees by chance 0.4 s off the other clips'."""
    report = reports["elsewhere"]
    assert abs(report.shift_ms) > 300
    assert report.corrected_ms == 0
    assert report.gap_r < 0.2
    assert report.left_out


def test_phonemes_come_from_the_text_or_are_recognised_and_that_is_said(reports):
    assert (reports["good"].phonemes, reports["second"].phonemes) == ("text", "recognised")


def test_sound_200_ms_late_is_found_put_right_and_told(imported, reports):
    assert reports["late"].shift_ms == pytest.approx(200, abs=20)
    assert reports["late"].corrected_ms == reports["late"].shift_ms
    assert "ms later than the picture: put right" in reports["late"].notes[0]
    late, good = (next(s for s in imported.sentences if s.name == n) for n in ("late", "second"))
    n = len(late.clip.samples) - 1000
    # The same moment of the recording, in samples of both clips.
    lags = range(-480, 481, 16)
    heard = good.clip.samples[500 : 500 + n]
    match = [float(late.clip.samples[500 + lag :][:n] @ heard) for lag in lags]
    assert abs(lags[int(np.argmax(match))]) / 16_000 <= 0.02


def test_sound_in_time_is_left_alone(reports):
    for name in ("good", "second"):
        assert abs(reports[name].shift_ms) < 20
        assert reports[name].corrected_ms == 0


def test_uneven_pictures_become_even_by_their_time_stamps(imported, reports):
    assert any("uneven times" in note for note in reports["uneven"].notes)
    sentence = next(s for s in imported.sentences if s.name == "uneven")
    seen_mm = tracked_gaps_mm(sentence.clip.points)
    times_s = np.arange(len(seen_mm)) / 25.0
    true_mm = np.interp(times_s, np.arange(len(gaps_mm())) * 0.01, gaps_mm())
    assert np.corrcoef(seen_mm, true_mm)[0, 1] > 0.97


def test_the_corpus_is_read_back_as_any_other(imported, tmp_path):
    corpus_folder = tmp_path / "corpus"
    check_corpus_folder(corpus_folder)
    write_corpus(corpus_folder, imported, {"tracker": "pixels"}, quietly, lambda _path: None)
    corpus = read_grid(corpus_folder)
    assert [u.name for u in corpus.labelled().utterances] == ["good", "late", "second", "uneven"]
    good = corpus.utterances[0]
    assert [word.text for word in good.words] == TEXT.split()
    assert soundfile.info(good.sound_path).samplerate == 16_000
    told = json.loads((corpus_folder / "import.json").read_text())
    assert {clip["clip"] for clip in told["clips"]} == {r.clip for r in imported.reports}


def test_a_corpus_that_cannot_be_completed_leaves_nothing(imported, tmp_path):
    def fail(_path):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_corpus(tmp_path / "corpus", imported, {}, quietly, fail)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_something_in_it_is_not_written_over(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="exists already"):
        check_corpus_folder(tmp_path)


def test_where_nothing_is_usable_the_reasons_are_told(folder, tmp_path):
    for name in ("mute", "nobody"):
        shutil.copy(folder / f"{name}.mkv", tmp_path)
    with pytest.raises(VideoError, match=r"no clip can be used: mute: has no sound.*nobody: no fa"):
        import_videos(find_clips(tmp_path), PixelTracker(), quietly)
