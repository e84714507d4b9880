"""Reading video: time stamps, sound on the pictures' axis, sound in a file beside."""

import numpy as np
import pytest

pytest.importorskip("av", reason="video needs PyAV, the extra `video`")

import soundfile
from lipservo_lab.video.video_clips import find_clips
from pixel_video import PixelFace, picture, write_video

from lipsync.video.video_file import VideoError, video_duration_s, video_pictures, video_sound

TIMES_S = np.arange(10) * 0.04


def write(path, samples, sound_from_s=0.0):
    return write_video(path, [picture([PixelFace(9)])] * 10, TIMES_S, samples, sound_from_s)


def beep():
    return (0.5 * np.sin(np.arange(6400) * 0.3)).astype(np.float32)


def test_pictures_come_as_they_were_written_with_their_times(tmp_path):
    read = list(video_pictures(write(tmp_path / "a.mkv", beep())))
    assert [time_s for time_s, _ in read] == pytest.approx(TIMES_S)
    np.testing.assert_array_equal(read[3][1], picture([PixelFace(9)]))
    assert video_duration_s(tmp_path / "a.mkv") == pytest.approx(0.4, abs=0.05)


def test_sound_that_begins_later_says_so(tmp_path):
    sound = video_sound(write(tmp_path / "a.mkv", beep(), sound_from_s=0.15))
    assert sound.begins_s == pytest.approx(0.15, abs=1e-3)
    np.testing.assert_allclose(sound.samples, beep(), atol=1e-4)


def test_a_wav_beside_goes_before_the_sound_in_the_file(tmp_path):
    path = write(tmp_path / "a.mkv", beep())
    soundfile.write(tmp_path / "a.wav", 0.1 * np.ones(4800), 48_000)
    sound = video_sound(path)
    assert len(sound.samples) == 1600
    assert sound.begins_s == 0.0


def test_silence_is_no_sound(tmp_path):
    with pytest.raises(VideoError, match="every sample of its sound is zero"):
        video_sound(write(tmp_path / "a.mkv", np.zeros(6400, np.float32)))


def test_a_place_without_videos_is_refused(tmp_path):
    with pytest.raises(VideoError, match="no such file or folder"):
        find_clips(tmp_path / "none")
    with pytest.raises(VideoError, match="has no video"):
        find_clips(tmp_path)


def test_a_text_beside_a_video_goes_before_the_list(tmp_path):
    for name in ("a.mkv", "b.MP4", "c.avi"):
        (tmp_path / name).touch()
    (tmp_path / "a.txt").write_text("from the file\n")
    (tmp_path / "transcripts.txt").write_text("a from the list\nb from the list\n")
    texts = {clip.name: clip.text for clip in find_clips(tmp_path)}
    assert texts == {"a": "from the file", "b": "from the list", "c": None}
    assert find_clips(tmp_path / "b.MP4")[0].text == "from the list"


def test_a_line_that_names_no_video_and_two_videos_of_one_name_are_refused(tmp_path):
    (tmp_path / "a.mkv").touch()
    (tmp_path / "transcripts.txt").write_text("b hello\n")
    with pytest.raises(VideoError, match="'b' is no video of the folder"):
        find_clips(tmp_path)
    (tmp_path / "a.mp4").touch()
    (tmp_path / "transcripts.txt").unlink()
    with pytest.raises(VideoError, match="two videos are called a"):
        find_clips(tmp_path)
