"""Synthesisers by name, and long texts sentence by sentence."""

from itertools import islice

import numpy as np
import pytest
import soundfile
from spoken_phonemes import check_spoken

from lipsync.plugins import SYNTHESIZERS
from lipsync.text_to_speech.synthesis import SynthesisError, UnspeakableTextError, Voice
from lipsync.text_to_speech.synthesizers import (
    LONGEST_PIECE,
    speak_in_pieces,
    synthesizer_for,
)

#: Those that need a model or a program of the user's speak in test_command_voice.py.
OWN_VOICES = {"piper", "command"}


@pytest.mark.parametrize("name", sorted({*SYNTHESIZERS.built_in} - OWN_VOICES))
def test_every_synthesiser_speaks_the_same_way(name):
    try:
        synthesizer = synthesizer_for(name)
    except SynthesisError as error:
        pytest.skip(str(error))

    assert Voice().language in synthesizer.languages()
    assert list(synthesizer.voices()) == sorted(synthesizer.voices())
    assert synthesizer.longest_text >= LONGEST_PIECE
    check_spoken(synthesizer.speak("Hello, Bob."))


def test_a_long_text_is_spoken_sentence_by_sentence_with_pauses_between():
    found = list(speak_in_pieces(synthesizer_for(), "Hello Bob. -- How are you? \U0001f600!"))

    assert [each.words[0].text for each in found] == ["Hello", "How"]
    for spoken in found:
        check_spoken(spoken)
        pause = spoken.phonemes[-1]
        assert pause.phoneme == "SIL"
        assert pause.end_s - pause.start_s > 0.15


def test_the_first_sentence_of_a_million_characters_sounds_before_the_rest_is_looked_at():
    asked = []

    class Counting:
        longest_text = LONGEST_PIECE

        def speak(self, text, voice):
            asked.append(text)
            return synthesizer_for().speak(text, voice)

    list(islice(speak_in_pieces(Counting(), "Hello there. " * 77_000), 2))
    assert asked == ["Hello there."] * 2


def test_a_million_letters_without_a_space_are_cut():
    (first,) = islice(speak_in_pieces(synthesizer_for(), "a" * 1_000_000), 1)
    check_spoken(first)


@pytest.mark.parametrize("text", ["", "-- ... \n\n --", "\x00" * 1000])
def test_a_text_in_which_nothing_can_be_spoken_is_one_line(text):
    with pytest.raises(UnspeakableTextError):
        list(speak_in_pieces(synthesizer_for(), text))


def test_a_language_that_is_not_spoken_is_told_at_the_first_piece():
    with pytest.raises(SynthesisError, match="does not speak"):
        next(speak_in_pieces(synthesizer_for(), "Hello.", Voice("xx")))


def test_a_sentence_that_a_voice_makes_longer_than_can_wait_is_one_line(tmp_path):
    soundfile.write(tmp_path / "said.wav", np.full(4_000 * 301, 0.1), 4_000)
    voice = Voice(name=f"cat {tmp_path}/said.wav")

    with pytest.raises(SynthesisError, match=r"'Hello\.': over 300 s long; check the voice"):
        next(speak_in_pieces(synthesizer_for("command"), "Hello.", voice))
