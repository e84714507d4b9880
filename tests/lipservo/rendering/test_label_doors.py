"""Every command reads every format of labels alike; docs/text.md has the table of it."""

import json

import numpy as np
import pytest
import soundfile
from label_files import OF_PHONES, OF_WORDS, PHONES, RHUBARB, RHUBARB_PHONES, VOICEVOX, WORDS
from lipservo_lab.corpus.alignment_cache import align_utterance
from lipservo_lab.corpus.transcribed import TranscribedUtterance
from places import ROOT

from lipservo.rendering.spoken_line import Script, spoken_line
from lipservo.rendering.spoken_sound import labels_of, spoken_sound
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.runtime.sound import spoken_file
from lipsync.audio.playout import Playout
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.textgrid import LabelError

RATE_HZ = 16_000
VOICEVOX_PHONES = ("K", "OW", "NG", "CH", "IY", "W", "AA")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Two seconds of a hiss."""
    path = tmp_path_factory.mktemp("sound") / "hello.wav"
    noise = 0.05 * np.random.default_rng(0).standard_normal(2 * RATE_HZ)
    soundfile.write(path, noise, RATE_HZ)
    return path


def said(events):
    """(phone, start in ms) without silences."""
    return [(e.phoneme, round(1e3 * e.start_s)) for e in events if e.phoneme != "SIL"]


def by_run(sound, labels):
    (stream,) = spoken_file(sound, Playout(), phonemes=labels).streams
    return said(stream.phonemes)


def by_export(sound, labels):
    return said(spoken_sound(sound, labels, ChosenMotion(), "face_sim", None).events())


def by_film(sound, labels):
    return said(labels_of(sound, labels).phones)


def by_render(sound, labels):
    return said(spoken_line(sound, Script(labels))[0].events)


def by_learn(sound, labels):
    done = align_utterance(TranscribedUtterance("a", "b", "hello mappy", sound, labels.path))
    return [(phone, 10 * first) for phone, first, _ in done.phones if phone != "SIL"]


#: `say --from` is `run --phonemes` with the sound beside the file.
COMMANDS = {
    "run, say": by_run,
    "export": by_export,
    "film": by_film,
    "lines render": by_render,
    "learn": by_learn,
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", [*OF_PHONES, *RHUBARB])
def test_each_command_reads_the_same_phones_and_times(tmp_path, sound, name, command):
    ending, text = {**OF_PHONES, **RHUBARB}[name]
    path = tmp_path / f"hello.{ending}"
    path.write_text(text, "utf-8")
    expected = RHUBARB_PHONES if name in RHUBARB else PHONES

    assert COMMANDS[command](sound, LabelFile(path)) == [
        (phone, round(1e3 * start_s)) for phone, start_s, _ in expected
    ]


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_reads_voicevox(tmp_path, sound, command):
    path = tmp_path / "hello.json"
    path.write_text(VOICEVOX)

    found = COMMANDS[command](sound, LabelFile(path))
    assert tuple(phone for phone, _ in found) == VOICEVOX_PHONES


@pytest.mark.parametrize("name", OF_WORDS)
def test_words_are_followed_in_the_sound_by_all_that_play_one(tmp_path, sound, name):
    path = tmp_path / "hello.json"
    path.write_text(json.dumps(OF_WORDS[name]))
    (stream,) = spoken_file(sound, Playout(), phonemes=LabelFile(path)).streams

    told = [word for started in stream.started_words for word in started.words]
    assert [(w.label.strip(), w.start_s) for w in told] == [(w, s) for w, s, _ in WORDS]
    words = labels_of(sound, LabelFile(path)).words
    assert [(w.label.strip(), w.start_s, w.end_s) for w in words] == list(WORDS)
    # A hiss is no speech; it is heard, and nothing breaks.
    spoken_line(sound, Script(LabelFile(path)))


def test_the_page_has_the_table_of_all_formats():
    tells = {"phones": [*OF_PHONES, "VOICEVOX"], "mouth shapes": [*RHUBARB], "words": [*OF_WORDS]}
    rows = "".join(f"| {what} | {'; '.join(files)} |\n" for what, files in tells.items())

    assert f"| tells | files |\n|---|---|\n{rows}" in (ROOT / "docs" / "text.md").read_text("utf-8")


INPUTS = ROOT.parent / "shared" / "inputs"
BASE = [(phone, round(1e3 * start_s)) for phone, start_s, _ in PHONES]
ARPABET = ("HH", "AH", "L", "OW", "SH", "IY", "TH", "EY")
RIGHT = {
    **dict.fromkeys(("base", "mfa_stress", "mfa_ipa", "mfa_tier_of_speaker"), BASE),
    **dict.fromkeys(("gap_of_100_ns", "zero_length"), BASE),
    **{f"{name}.json": BASE for name in ("rows", "gentle")},
    **{
        f"arpabet_{case}_case.json": [(x, at) for x, (_, at) in zip(ARPABET, BASE, strict=True)]
        for case in ("upper", "lower")
    },
}
WRONG = {
    "times_in_ms": "ends at 1600.000 s, but the sound is 2.000 s long",
    "cut_half": "tier 'phones' has 1 of 11 labels, up to 0.100 s of 2.000 s; the file is cut off",
    "audio2face.json": "weights of face shapes (as Audio2Face exports them)",
}


def given(name):
    """A small input, and the sound beside it."""
    path = INPUTS / (name if "." in name else f"{name}.TextGrid")
    if not path.is_file():
        pytest.skip("../shared/inputs is not beside this checkout")
    return INPUTS / "two_seconds.wav", LabelFile(path)


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", RIGHT)
def test_the_small_inputs_that_people_have_are_read_right(name, command):
    assert COMMANDS[command](*given(name)) == RIGHT[name]


@pytest.mark.parametrize("command", [each for each in COMMANDS if each != "learn"])
@pytest.mark.parametrize("name", WRONG)
def test_the_small_inputs_that_are_wrong_are_refused_by_every_command_alike(name, command):
    with pytest.raises(LabelError) as raised:
        COMMANDS[command](*given(name))
    assert WRONG[name] in str(raised.value)


def test_a_word_without_a_time_is_passed_over_with_a_line():
    sound, labels = given("whisperx_number_without_time.json")
    read = labels_of(sound, labels)

    assert [each.label for each in read.words] == ["hello"]
    assert "word 'mappy' has no time; it is passed over" in read.notes
