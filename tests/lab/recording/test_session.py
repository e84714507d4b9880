"""Sessions in an invented room: real microphone code, real files, invented hardware and time."""

import av
import numpy as np
import pytest
import soundfile
from lipservo_lab.recording.sentence_list import Sentence, SentenceError, recorded_names
from lipservo_lab.recording.session import Screen, Session
from recorded_room import Room, speech

from lipservo.calibrating.camera import CameraError

SENTENCES = (
    Sentence("s001", "One thing."),
    Sentence("s002", "Another."),
    Sentence("s003", "Last."),
)
ONE_TAKE = [(1.0, " "), (3.0, " "), (3.6, "q")]


def record(room, folder, sentences=SENTENCES):
    with room.microphone:
        session = Session(room.devices(), Screen(quiet=True), folder)
        return session.run(sentences, recorded_names(folder, sentences))


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def clip(path):
    """Times and brightness of the pictures, and the sound."""
    with av.open(str(path)) as file:
        seen = [(f.time, f.to_ndarray(format="gray").mean()) for f in file.decode(video=0)]
    with av.open(str(path)) as file:
        heard = np.concatenate([f.to_ndarray()[0] for f in file.decode(audio=0)]) / 32767
    times, luma = np.array(seen).T
    return times, luma, heard


def test_a_take_is_three_files_that_agree(monkeypatch, tmp_path):
    outcome = record(Room(monkeypatch, ONE_TAKE), tmp_path)
    assert (outcome.recorded, outcome.warnings) == (["s001"], {})
    assert names(tmp_path) == ["s001.mkv", "s001.txt", "s001.wav"]
    assert (tmp_path / "s001.txt").read_text() == "One thing.\n"
    times, _, heard = clip(tmp_path / "s001.mkv")
    samples, rate_hz = soundfile.read(tmp_path / "s001.wav")
    assert rate_hz == 16_000
    np.testing.assert_allclose(heard, samples, atol=1e-4)
    assert times[0] == 0.0
    np.testing.assert_allclose(np.diff(times), 1 / 30, atol=1.1e-3)
    # From 0.15 s after the first key to 0.15 s before the second.
    assert len(samples) / rate_hz == pytest.approx(1.7, abs=0.06)
    assert times[-1] < len(samples) / rate_hz <= times[-1] + 2 / 30


def test_sound_and_picture_show_a_clap_at_the_same_time(monkeypatch, tmp_path):
    """Every half second for 40 ms: a flash and a burst, which arrive with different delays."""

    def clap(time_s):
        return speech(time_s) * 0.05 + np.where(time_s % 0.5 < 0.04, 0.5, 0.0)

    room = Room(monkeypatch, ONE_TAKE, sound=clap, luma=lambda t: 200 if t % 0.5 < 0.04 else 100)
    record(room, tmp_path)
    times, luma, heard = clip(tmp_path / "s001.mkv")
    onsets = np.flatnonzero(np.diff((np.abs(heard) > 0.3).astype(int)) == 1) / 16_000
    flashes = times[1:][(luma[1:] > 150) & (luma[:-1] < 150)]
    assert len(onsets) == len(flashes) >= 3
    # A picture is taken up to a frame's time after the flash begins.
    late = flashes - onsets
    assert (late > -0.003).all()
    assert (late < 1 / 30 + 0.003).all()


def test_an_interrupted_session_goes_on_where_it_was(monkeypatch, tmp_path):
    record(Room(monkeypatch, ONE_TAKE), tmp_path)
    again = record(Room(monkeypatch, ONE_TAKE), tmp_path)
    assert again.recorded == ["s002"]
    (tmp_path / "s001.wav").unlink()
    assert recorded_names(tmp_path, SENTENCES) == {"s002"}


def test_another_list_is_not_mixed_into_a_folder(monkeypatch, tmp_path):
    record(Room(monkeypatch, ONE_TAKE), tmp_path)
    with pytest.raises(SentenceError, match="holds another sentence than this list"):
        recorded_names(tmp_path, [Sentence("s001", "Something else.")])


def test_keys_skip_repeat_and_go_back(monkeypatch, tmp_path):
    keys = [
        (1.0, "s"),  # not the first
        (1.5, " "), (2.5, "r"),  # a slip of the tongue
        (3.0, " "), (5.0, " "),  # the second
        (6.0, "b"), (6.2, " "), (8.5, " "),  # the second once more
        (9.5, "q"),
    ]  # fmt: skip
    outcome = record(Room(monkeypatch, keys), tmp_path)
    assert outcome.skipped == ["s001"]
    assert outcome.recorded == ["s002", "s002"]
    assert soundfile.info(tmp_path / "s002.wav").duration == pytest.approx(2.0, abs=0.06)


@pytest.mark.parametrize(
    ("changes", "warning"),
    [
        ({"sound": lambda t: speech(t) * 20}, "clipped"),
        ({"sound": lambda t: speech(t) * 0.01}, "too quiet"),
        ({"sound": lambda t: speech(t * 0 + 0.1)}, "above the noise"),
        ({"luma": lambda _: 30}, "too dark"),
        ({"rate_hz": 15.0}, "15.0 pictures a second, 30 were promised"),
    ],
)
def test_a_bad_take_is_asked_about_and_kept_only_where_somebody_says_so(
    monkeypatch, tmp_path, capsys, changes, warning
):
    keys = [(1.0, " "), (3.0, " "), (4.0, " "), (5.0, "q")]
    assert record(Room(monkeypatch, keys, **changes), tmp_path).recorded == []
    assert names(tmp_path) == []
    assert warning in capsys.readouterr().err
    keys = [(1.0, " "), (3.0, " "), (4.0, "k"), (5.0, "q")]
    outcome = record(Room(monkeypatch, keys, **changes), tmp_path)
    assert warning in outcome.warnings["s001"][0]


@pytest.mark.parametrize("moment_s", [0.5, 1.5, 3.2])
def test_a_signal_at_any_moment_leaves_whole_files(monkeypatch, tmp_path, moment_s):
    room = Room(monkeypatch, [(0.3, " "), (2.5, " "), (3.0, " ")])
    room.stopped_at_s = 2.9 + moment_s
    record(room, tmp_path)
    assert names(tmp_path) == ["s001.mkv", "s001.txt", "s001.wav"]


def test_a_camera_that_fails_in_a_take_leaves_what_was_kept(monkeypatch, tmp_path):
    room = Room(monkeypatch, [(0.3, " "), (2.5, " "), (3.5, " ")])
    room.fails_at_s = 4.5
    with pytest.raises(CameraError, match="has failed"):
        record(room, tmp_path)
    assert names(tmp_path) == ["s001.mkv", "s001.txt", "s001.wav"]


def test_a_take_said_again_and_given_up_leaves_the_one_before(monkeypatch, tmp_path):
    record(Room(monkeypatch, ONE_TAKE), tmp_path)
    before = (tmp_path / "s001.wav").read_bytes()
    keys = [(0.5, "b"), (1.0, " "), (3.0, "q")]
    record(Room(monkeypatch, keys), tmp_path)
    assert (tmp_path / "s001.wav").read_bytes() == before
    assert names(tmp_path) == ["s001.mkv", "s001.txt", "s001.wav"]
