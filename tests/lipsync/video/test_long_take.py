"""A long video is cut at its pauses: what is wrong in one part costs that part alone."""

import numpy as np
import pytest

pytest.importorskip("av", reason="video needs PyAV, the extra `video`")

from lipservo_lab.video.video_clips import find_clips
from lipservo_lab.video.video_import import import_videos
from pixel_video import PixelFace, PixelTracker, picture, write_video
from talking_pixels import gaps_mm, speech

_PAUSE_S = 0.5


def write_long(path, n_times, hidden_s):
    """Write a video of a sentence `n_times` with pauses between, without a face in `hidden_s`.

    hidden_s: (from, to) in s. Returns what `write_video` returns.
    """
    pause = np.zeros(round(_PAUSE_S * 16_000), np.float32)
    samples = np.tile(np.concatenate((speech(), pause)), n_times)
    gaps = np.tile(np.concatenate((gaps_mm(), np.zeros(round(_PAUSE_S * 100)))), n_times)
    times_s = np.arange(0, len(samples) / 16_000, 0.04)
    seen_mm = np.interp(times_s, np.arange(len(gaps)) * len(samples) / 16_000 / len(gaps), gaps)
    pictures = [
        picture([] if hidden_s[0] <= t < hidden_s[1] else [PixelFace(gap)])
        for t, gap in zip(times_s, seen_mm, strict=True)
    ]
    return write_video(path, pictures, times_s, samples)


@pytest.mark.slow
def test_a_long_take_becomes_sentences_and_a_hidden_face_costs_one(tmp_path):
    write_long(tmp_path / "take.mkv", 4, (6.5, 7.0))
    imported = import_videos(
        find_clips(tmp_path / "take.mkv"), PixelTracker(), lambda _what, _n, _all: None
    )
    reports = {report.clip: report for report in imported.reports}
    assert list(reports) == ["take-001", "take-002", "take-003", "take-004"]
    assert reports["take-002"].left_out.startswith("no face from 1.")
    assert [s.name for s in imported.sentences] == ["take-001", "take-003", "take-004"]
    sentence_s = len(speech()) / 16_000 + _PAUSE_S
    for sentence in imported.sentences[:2]:
        assert len(sentence.clip.points) / 25 == pytest.approx(sentence_s, abs=0.4)
        assert sentence.labels.phones[0].start_s == 0.0
        last_s = sentence.labels.phones[-1].end_s
        assert last_s == pytest.approx(len(sentence.clip.points) / 25, abs=0.05)
    assert all(abs(r.shift_ms) < 30 for r in reports.values() if r.left_out is None)
