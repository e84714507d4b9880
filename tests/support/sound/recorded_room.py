"""A room in which somebody is recorded: sound, pictures and keys by one invented clock."""

import av
import numpy as np
from fake_sound_card import install_sound_card
from lipservo_lab.recording.session import Devices

from lipservo.calibrating.camera import CameraError
from lipsync.audio.microphone import MicrophoneSource

STEP_S = 0.01
RATE_HZ = 30.0


def picture(luma, width=64, height=48):
    return av.VideoFrame.from_ndarray(np.full((height, width), luma, np.uint8), format="gray")


def speech(time_s):
    """Noise that is loud for 0.4 s and soft for 0.4 s, by the clock: (n,) for times (n,)."""
    rng = np.random.default_rng(round(time_s[0] * 100))
    return rng.normal(0.0, np.where(time_s % 0.8 < 0.4, 0.1, 0.001))


class Room:
    """`keys`: (time, key) in order, times from 0 on; the last should be q."""

    def __init__(self, monkeypatch, keys, *, sound=speech, luma=lambda _: 120, rate_hz=RATE_HZ):
        self.card = install_sound_card(monkeypatch)
        self.keys, self.sound, self.luma, self.rate_hz = list(keys), sound, luma, rate_hz
        self.begun_s = self.card.now_s
        self.frames, self.n_frames = [], 0
        self.fails_at_s = np.inf
        self.stopped_at_s = np.inf
        self.microphone = MicrophoneSource(None, clock=self.card.clock, is_watched=False)

    @property
    def now_s(self):
        return self.card.now_s - self.begun_s

    def sleep(self, seconds):
        for _ in range(round(seconds / STEP_S)):
            self._step()

    def _step(self):
        self.card.now_s += STEP_S
        assert self.now_s < 30.0, "nobody ended the session"
        stream = self.card.inputs[-1]
        n = round(STEP_S * stream.rate_hz)
        # Captured within the last 10 ms, and told 5 ms later.
        times_s = self.now_s - STEP_S - 0.005 + np.arange(n) / stream.rate_hz
        stream.deliver(self.sound(times_s), age_s=STEP_S + 0.005)
        while (taken_s := self.n_frames / self.rate_hz) <= self.now_s - 0.02:
            self.frames.append((self.begun_s + taken_s, picture(self.luma(taken_s))))
            self.n_frames += 1

    def next_key(self, timeout_s):
        if self.keys and self.keys[0][0] <= self.now_s:
            return self.keys.pop(0)[1]
        self.sleep(timeout_s)
        return None

    def take_frames(self):
        if self.now_s >= self.fails_at_s:
            raise CameraError("camera '0' has failed (No such device); plug it in again")
        frames, self.frames = self.frames, []
        return frames

    def devices(self):
        return Devices(
            self.microphone, self, RATE_HZ, self.next_key,
            lambda: self.now_s >= self.stopped_at_s, self.card.clock, self.sleep,
        )  # fmt: skip
