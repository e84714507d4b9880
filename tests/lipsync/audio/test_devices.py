import ctypes
import subprocess
import sys
import threading

import pytest
from fake_sound_card import device, install_sound_card

from lipsync.audio.devices import find_device, offset_ms_of, restart_portaudio, sound_devices
from lipsync.audio.loudspeaker import LoudspeakerOutput
from lipsync.audio.microphone import MicrophoneSource
from lipsync.audio.source import SoundError


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


@pytest.mark.usefixtures("card")
def test_inputs_and_outputs_are_listed_apart_and_the_defaults_are_marked():
    told = {
        direction: [(d.index, d.lasting_name, d.n_channels, d.is_default) for d in found]
        for direction in ("input", "output")
        if (found := sound_devices(direction))
    }
    assert told == {
        "input": [(1, "USB mic: -", 1, True), (2, "array", 4, False)],
        "output": [(0, "USB speaker: -", 2, True), (3, "HDMI", 8, False)],
    }


@pytest.mark.usefixtures("card")
def test_a_device_is_named_by_number_or_by_part_of_its_name():
    assert {find_device(each, "output").index for each in (3, "3", "HDMI", "HD")} == {3}
    assert {find_device(each, "input").index for each in (2, "2", "array")} == {2}


@pytest.mark.usefixtures("card")
@pytest.mark.parametrize(
    ("wanted", "direction", "told"),
    [
        ("array", "output", r"no single loudspeaker 'array'; .*0 USB speaker.*3 HDMI"),
        ("webcam", "input", r"no single microphone 'webcam'; .*1 USB mic.*; 2 array"),
    ],
)
def test_an_unknown_device_is_refused_with_the_list_of_those_there_are(wanted, direction, told):
    with pytest.raises(SoundError, match=told):
        find_device(wanted, direction)


@pytest.mark.parametrize(
    ("direction", "has", "told"),
    [
        ("output", {"n_inputs": 4}, "no loudspeaker: plug one in, or leave out --play"),
        ("input", {"n_outputs": 2}, "no microphone: plug one in"),
    ],
)
def test_a_computer_without_such_a_device_is_told_so(monkeypatch, direction, has, told):
    install_sound_card(monkeypatch, devices=[device(0, "array", **has)])
    with pytest.raises(SoundError, match=told):
        find_device(None, direction)


def test_the_longest_name_that_is_part_of_the_device_says_its_offset():
    offsets_ms = {"USB": 20.0, "USB speaker": 31.5, "HDMI": 80.0}
    assert offset_ms_of("USB speaker: - (hw:3,0)", offsets_ms) == 31.5
    assert offset_ms_of("USB headset", offsets_ms) == 20.0
    assert offset_ms_of("default", offsets_ms) == 0.0


def test_portaudio_starts_again_only_while_no_stream_is_open(card):
    """It would end the others'."""
    with LoudspeakerOutput(clock=card.clock, is_watched=False):
        with MicrophoneSource(clock=card.clock, is_watched=False):
            assert not restart_portaudio()
        assert not restart_portaudio()
    assert restart_portaudio()
    assert card.n_looks == 1


def test_portaudio_that_does_not_start_is_tried_again_each_second(card):
    with MicrophoneSource(clock=card.clock, is_watched=False) as microphone:
        card.inputs[0].active, card.refuses_to_run = False, True
        for _ in range(35):
            card.now_s += 0.1
            microphone.watch.check()
        assert (microphone.is_lost, card.n_looks) == (True, 3)
        card.refuses_to_run = False
        card.now_s += 1.0
        microphone.watch.check()
        assert not microphone.is_lost


def test_portaudio_does_not_start_again_while_another_thread_opens_a_device(card):
    """Between the making of a stream and its start it would be ended unseen."""
    other = threading.Thread(target=restart_portaudio)

    def begin_to_list():
        other.start()
        other.join(0.2)

    card.while_opening = begin_to_list
    with LoudspeakerOutput(clock=card.clock, is_watched=False):
        other.join()
        assert card.n_looks == 0


def test_alsa_prints_nothing():
    """What it prints of a slow computer would fill a log; see `quiet_alsa`."""
    script = """
import ctypes, sys
from lipsync.audio.devices import quiet_alsa
alsa = ctypes.CDLL("libasound.so.2")
if sys.argv[1] == "quiet":
    quiet_alsa()
    quiet_alsa()
device = ctypes.c_void_p()
assert alsa.snd_pcm_open(ctypes.byref(device), b"no such device", 0, 0) < 0
"""
    try:
        ctypes.CDLL("libasound.so.2")
    except OSError:
        pytest.skip("no ALSA: apt install libasound2")
    said = [
        subprocess.run([sys.executable, "-c", script, how], capture_output=True, check=True).stderr
        for how in ("loud", "quiet")
    ]
    assert b"no such device" in said[0]
    assert said[1] == b""
