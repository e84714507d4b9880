import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from lipsync.audio.microphone import QUEUE_S, MicrophoneSource, input_devices
from lipsync.audio.source import SoundError


class FakePortAudioError(Exception):
    pass


class FakeStream:
    """A sound card that delivers when the test says so."""

    def __init__(self, *, samplerate, channels, callback, **_settings):
        self.rate_hz, self.n_channels, self.callback = samplerate, channels, callback
        self.active = False
        self.adc_s = 100.0  # PortAudio's clock starts anywhere

    def start(self):
        self.active = True

    def close(self):
        self.active = False

    def deliver(self, samples, *, lost_before_s=0.0, overflow=False):
        self.adc_s += lost_before_s
        frames = np.repeat(np.asarray(samples, np.float32)[:, None], self.n_channels, axis=1)
        timing = SimpleNamespace(inputBufferAdcTime=self.adc_s)
        self.callback(frames, len(frames), timing, SimpleNamespace(input_overflow=overflow))
        frames[:] = np.nan  # PortAudio takes its buffer back
        self.adc_s += len(samples) / self.rate_hz


class FakeSoundDevice:
    """What lipservo uses of the sounddevice module, over invented hardware."""

    PortAudioError = FakePortAudioError

    def __init__(self, devices, rates_hz):
        self.devices, self.rates_hz, self.streams = devices, rates_hz, []
        self.default = SimpleNamespace(device=(1 if devices else -1, -1))

    def query_devices(self, device=None, kind=None):
        if kind is None:
            return self.devices
        wanted = self.default.device[0] if device is None else device
        found = [
            d
            for d in self.devices
            if d["index"] == wanted or (isinstance(wanted, str) and wanted in d["name"])
        ]
        if len(found) != 1:
            raise ValueError(f"No input device matching {device!r}")
        return found[0]

    def check_input_settings(self, *, samplerate, **_settings):
        if samplerate not in self.rates_hz:
            raise self.PortAudioError("Invalid sample rate")

    def InputStream(self, **settings):  # noqa: N802 - sounddevice's name
        self.streams.append(FakeStream(**settings))
        return self.streams[-1]


def device(index, name, n_inputs):
    return {
        "index": index,
        "name": name,
        "max_input_channels": n_inputs,
        "default_samplerate": 48_000.0,
    }


@pytest.fixture
def install(monkeypatch):
    def put(devices=None, rates_hz=(16_000, 48_000)):
        if devices is None:
            devices = [device(0, "loudspeaker", 0), device(1, "USB mic", 1), device(2, "array", 4)]
        module = FakeSoundDevice(devices, rates_hz)
        monkeypatch.setitem(sys.modules, "sounddevice", module)
        return module

    return put


def ramp(n_samples, rate_hz=16_000):
    return np.arange(1, n_samples + 1) / rate_hz


def heard(blocks):
    return np.concatenate([block.samples for block in blocks])


def test_what_the_device_delivers_comes_out_in_blocks_of_10_ms(install):
    card = install()
    with MicrophoneSource() as microphone:
        card.streams[0].deliver(ramp(400))
        blocks = microphone.blocks(math.inf)

    assert [block.start_s for block in blocks] == [0.0, 0.01]
    np.testing.assert_array_equal(heard(blocks), ramp(320).astype(np.float32))
    assert microphone.name == "USB mic"
    assert not card.streams[0].active


def test_blocks_later_than_asked_for_wait(install):
    card = install()
    with MicrophoneSource() as microphone:
        card.streams[0].deliver(ramp(800))

        assert [b.start_s for b in microphone.blocks(0.02)] == [0.0, 0.01]
        assert [b.start_s for b in microphone.blocks(math.inf)] == [0.02, 0.03, 0.04]


def test_sound_dropped_from_a_full_queue_is_replaced_by_silence_of_the_same_length(install):
    card = install()
    n_queued = round(QUEUE_S * 100)
    with MicrophoneSource() as microphone:
        for n in range(n_queued + 30):
            card.streams[0].deliver(np.full(160, (n + 1) / 1_000))
        blocks = microphone.blocks(math.inf)

    assert microphone.lost_blocks == 30
    assert len(blocks) == n_queued + 30
    assert not np.any(heard(blocks[:30]))
    assert blocks[30].samples[0] == np.float32(0.031)
    assert blocks[-1].samples[0] == np.float32((n_queued + 30) / 1_000)


def test_sound_that_the_device_lost_is_replaced_by_as_much_silence_as_its_clock_says(install):
    card = install()
    with MicrophoneSource() as microphone:
        card.streams[0].deliver(np.full(160, 0.1))
        card.streams[0].deliver(np.full(160, 0.2), lost_before_s=0.05, overflow=True)
        blocks = microphone.blocks(math.inf)

    assert [float(b.samples[0]) for b in blocks] == pytest.approx([0.1, 0, 0, 0, 0, 0, 0.2])
    assert microphone.lost_blocks == 5


def test_a_device_clock_that_says_nothing_costs_one_block(install):
    card = install()
    with MicrophoneSource() as microphone:
        card.streams[0].deliver(np.full(160, 0.1))
        card.streams[0].deliver(np.full(160, 0.2), overflow=True)

        assert len(microphone.blocks(math.inf)) == 3
        assert microphone.lost_blocks == 1


def test_a_device_that_cannot_do_16_khz_is_opened_at_its_own_rate_and_resampled(install):
    card = install(rates_hz=(48_000,))
    tone = np.sin(2 * np.pi * 300 * np.arange(48_000) / 48_000)
    with MicrophoneSource("array") as microphone:
        stream = card.streams[0]
        for first in range(0, 48_000, 480):
            stream.deliver(0.5 * tone[first : first + 480])
        samples = heard(microphone.blocks(math.inf))

    assert stream.rate_hz == 48_000
    assert len(samples) >= 15_680  # the resampler holds 20 ms back at most
    expected = 0.5 * np.sin(2 * np.pi * 300 * np.arange(len(samples)) / 16_000)
    np.testing.assert_allclose(samples[400:], expected[400:], atol=1e-3)


def test_listening_again_starts_at_sound_time_zero(install):
    card = install()
    microphone = MicrophoneSource()
    with microphone:
        card.streams[0].deliver(ramp(480))
        microphone.blocks(math.inf)
    with microphone:
        card.streams[1].deliver(ramp(160))

        assert [b.start_s for b in microphone.blocks(math.inf)] == [0.0]


@pytest.mark.parametrize("wanted", [2, "2", "array"])
def test_a_device_is_named_by_index_or_by_part_of_its_name(install, wanted):
    install()

    assert MicrophoneSource(wanted).name == "array"


def test_an_unknown_device_is_refused_with_the_list_of_those_there_are(install):
    install()

    with pytest.raises(SoundError, match=r"no single microphone 'webcam'; .*1 USB mic; 2 array"):
        MicrophoneSource("webcam")


def test_an_unplugged_device_is_reported(install):
    card = install()
    with MicrophoneSource() as microphone:
        card.streams[0].active = False

        with pytest.raises(SoundError, match="microphone 'USB mic' stopped"):
            microphone.blocks(math.inf)


def test_a_computer_without_a_microphone_is_told_so(install):
    install(devices=[device(0, "loudspeaker", 0)])

    with pytest.raises(SoundError, match="no microphone: plug one in"):
        MicrophoneSource()


def test_a_missing_portaudio_is_reported_with_the_command_that_installs_it(monkeypatch):
    class Finder:
        """Importing sounddevice ends as it does where the library is not found."""

        def find_spec(self, name, _path, _target=None):
            if name == "sounddevice":
                raise OSError("PortAudio library not found")

    monkeypatch.delitem(sys.modules, "sounddevice", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])

    with pytest.raises(SoundError, match="apt install libportaudio2"):
        MicrophoneSource()


def test_only_devices_with_inputs_are_listed_and_the_default_is_marked(install):
    install()

    assert [(d.index, d.name, d.n_channels, d.is_default) for d in input_devices()] == [
        (1, "USB mic", 1, True),
        (2, "array", 4, False),
    ]
