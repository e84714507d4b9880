"""Cameras: what stands in for one, what cannot be opened, and time stamps of other clocks."""

import math
from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipservo.calibrating.camera import AvCamera, CameraError, CameraFeed, CameraMode, StampClock


def test_a_generator_stands_in_at_its_own_pace():
    now_s = [50.0]

    def sleep(seconds):
        now_s[0] += seconds

    with AvCamera(
        "lavfi:testsrc=size=64x48:rate=25", clock=lambda: now_s[0], sleep=sleep
    ) as camera:
        assert camera.rate_hz == 25.0
        frames = list(islice(camera.frames(), 4))
    assert [time_s for time_s, _ in frames] == pytest.approx([50.0, 50.04, 50.08, 50.12])
    assert now_s[0] == pytest.approx(50.12)
    assert (frames[0][1].width, frames[0][1].height) == (64, 48)


def test_a_camera_that_is_not_there_is_one_line():
    with pytest.raises(CameraError, match=r"'/dev/no-camera' cannot be opened \(No such file"):
        AvCamera("/dev/no-camera", CameraMode(640, 480, 30.0)).__enter__()


def test_what_is_no_video_is_refused(tmp_path):
    path = tmp_path / "text.mkv"
    path.write_text("no video")
    with pytest.raises(CameraError, match="cannot be opened"):
        AvCamera(str(path)).__enter__()


def test_a_clip_that_ends_is_told():
    camera = AvCamera("lavfi:testsrc=size=64x48:rate=25:duration=0.1", sleep=lambda _: None)
    frames = []

    def read_on(feed):
        while True:
            frames.extend(feed.take_frames())

    with CameraFeed(camera) as feed, pytest.raises(CameraError, match="stopped sending pictures"):
        read_on(feed)
    assert len(frames) == 3


def test_the_kernels_own_time_stamps_are_taken_as_they_are():
    clock = StampClock()
    assert clock.time_s(999.96, 1000.0) == 999.96
    assert clock.time_s(999.99, 1000.2) == 999.99


@given(
    zero_s=st.floats(100.0, 1e9), delays_s=st.lists(st.floats(0.02, 0.4), min_size=30, max_size=60)
)
def test_another_clock_is_brought_to_ours_by_the_soonest_picture(zero_s, delays_s):
    """However late single pictures arrive, their distances are those of their time stamps."""
    delays_s[0] = 0.02
    clock = StampClock()
    stamps_s = np.arange(len(delays_s)) / 30
    placed = [
        clock.time_s(zero_s + stamp_s, 5.0 + stamp_s + delay_s)
        for stamp_s, delay_s in zip(stamps_s, delays_s, strict=True)
    ]
    assert not math.isnan(placed[0])
    np.testing.assert_allclose(np.array(placed) - 5.02, stamps_s, atol=1e-6)
