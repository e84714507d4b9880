"""A sounddevice module over invented hardware: cards that deliver and take when a test says so."""

import sys
from types import SimpleNamespace

import numpy as np


class FakePortAudioError(Exception):
    pass


class FakeStream:
    """PortAudio's clock starts anywhere, and here it is a thousand seconds before the monotonic."""

    def __init__(self, card, *, samplerate, channels, callback, **settings):
        self.card, self.callback, self.settings = card, callback, settings
        self.rate_hz, self.n_channels = samplerate, channels
        self.active, self.is_closed = False, False
        self.latency = 0.06
        card.while_opening()

    @property
    def time(self):
        return self.card.now_s + 1_000.0

    def start(self):
        if self.card.refuses_to_start:
            raise FakePortAudioError("Device unavailable")
        self.active = True
        self.card.while_starting()

    def abort(self):
        self.active = False

    def close(self):
        self.active, self.is_closed = False, True


class FakeInputStream(FakeStream):
    adc_s = 1_100.0

    def deliver(self, samples, *, lost_before_s=0.0, overflow=False, age_s=None):
        """Samples that the card has captured, at its own clock; age_s: how long ago, if given.

        samples: (n,), the same on every channel, or (n, channels).
        """
        self.adc_s += lost_before_s
        adc_s = self.adc_s if age_s is None else self.time - age_s
        samples = np.asarray(samples, np.float32)
        samples = samples[:, None] if samples.ndim == 1 else samples
        frames = np.broadcast_to(samples, (len(samples), self.n_channels)).copy()
        timing = SimpleNamespace(inputBufferAdcTime=adc_s)
        self.callback(frames, len(frames), timing, SimpleNamespace(input_overflow=overflow))
        frames[:] = np.nan  # PortAudio takes its buffer back
        self.adc_s += len(samples) / self.rate_hz


class FakeOutputStream(FakeStream):
    def ask(self, *, ahead_s=0.05, dac_s=None, underflow=False):
        """A block of 10 ms (n, channels) that leaves the card `ahead_s` from now."""
        frames = np.full((self.rate_hz // 100, self.n_channels), np.nan, dtype=np.float32)
        told_s = self.time + ahead_s if dac_s is None else dac_s
        timing = SimpleNamespace(outputBufferDacTime=told_s)
        self.callback(frames, len(frames), timing, SimpleNamespace(output_underflow=underflow))
        return frames


class FakeSoundDevice:
    """What lipservo uses of the sounddevice module. `now_s` is the monotonic clock."""

    PortAudioError = FakePortAudioError

    def __init__(self, devices, rates_hz, channels):
        self.devices, self.rates_hz, self.channels = devices, rates_hz, channels
        self.plugged = None  # what is plugged in by the time that PortAudio looks again
        self.inputs, self.outputs = [], []
        self.now_s = 100.0
        self.n_looks = 0
        self.refuses_to_start = False
        self.while_opening = self.while_starting = lambda: None
        self.is_running = True  # PortAudio itself, where it was not refused its start
        self.refuses_to_run = False

    def clock(self):
        return self.now_s

    @property
    def default(self):
        first = [
            next((d["index"] for d in self.devices if d[channels]), -1)
            for channels in ("max_input_channels", "max_output_channels")
        ]
        return SimpleNamespace(device=tuple(first))

    def query_devices(self, device=None, kind=None):
        if kind is None:
            return self.devices
        side = 0 if kind == "input" else 1
        wanted = self.default.device[side] if device is None else device
        found = [
            d
            for d in self.devices
            if d[f"max_{kind}_channels"]
            and (d["index"] == wanted or (isinstance(wanted, str) and wanted in d["name"]))
        ]
        if len(found) != 1:
            raise ValueError(f"No {kind} device matching {device!r}")
        return found[0]

    def check_input_settings(self, *, samplerate, **_settings):
        if samplerate not in self.rates_hz:
            raise self.PortAudioError("Invalid sample rate")

    def check_output_settings(self, *, samplerate, channels, **_settings):
        if samplerate not in self.rates_hz:
            raise self.PortAudioError("Invalid sample rate")
        if channels not in self.channels:
            raise self.PortAudioError("Invalid number of channels")

    def InputStream(self, **settings):  # noqa: N802 - sounddevice's name
        self.inputs.append(FakeInputStream(self, **settings))
        return self.inputs[-1]

    def OutputStream(self, **settings):  # noqa: N802 - sounddevice's name
        self.outputs.append(FakeOutputStream(self, **settings))
        return self.outputs[-1]

    def _terminate(self):
        for stream in (*self.inputs, *self.outputs):
            assert stream.is_closed, "PortAudio ends open streams when it ends"
        if not self.is_running:
            raise FakePortAudioError("PortAudio not initialized")

    def _initialize(self):
        self.n_looks += 1
        self.is_running = not self.refuses_to_run
        if not self.is_running:
            raise FakePortAudioError("Unanticipated host error")
        self.devices = self.devices if self.plugged is None else self.plugged


def device(index, name, n_inputs=0, n_outputs=0):
    """As PortAudio describes one."""
    return {
        "index": index,
        "name": name,
        "max_input_channels": n_inputs,
        "max_output_channels": n_outputs,
        "default_samplerate": 48_000.0,
    }


DEVICES = (
    device(0, "USB speaker: - (hw:1,0)", n_outputs=2),
    device(1, "USB mic: - (hw:2,0)", n_inputs=1),
    device(2, "array", n_inputs=4),
    device(3, "HDMI", n_outputs=8),
)


def install_sound_card(monkeypatch, devices=DEVICES, rates_hz=(16_000, 48_000), channels=(1, 2)):
    """Put it in place of sounddevice."""
    module = FakeSoundDevice(list(devices), rates_hz, channels)
    monkeypatch.setitem(sys.modules, "sounddevice", module)
    return module
