"""Synthetic voices become corpora that are read like any other."""

import pytest
import soundfile
from lipservo_lab.corpus.alignment_cache import LABELLED, align_corpus
from lipservo_lab.corpus.transcribed import read_transcribed
from lipservo_lab.learning.recognition.festival import Festival
from lipservo_lab.learning.recognition.synthetic_corpus import (
    SyntheticVoice,
    SyntheticVoiceError,
    read_voices,
    write_voice,
)

from lipsync.text_to_speech.synthesis import SynthesisError, Voice

TEXTS = ["Put the big box by the boat", "My mother may move it"]


def test_voices_are_written_with_their_synthesiser():
    voices = read_voices("espeak:en-us, festival:ked")
    assert voices == (SyntheticVoice("espeak", "en-us"), SyntheticVoice("festival", "ked"))
    assert [voice.folder_name for voice in voices] == ["espeak-en-us", "festival-ked"]


@pytest.mark.parametrize("listed", ["", "awb", "flite:", "nobody:amy", "flite:awb,"])
def test_another_form_is_refused_in_one_line(listed):
    with pytest.raises(SyntheticVoiceError, match="is no SYNTHESISER:VOICE"):
        read_voices(listed)


@pytest.fixture(params=["espeak:en-us", "flite:awb", "festival:ked", "festival:ked-sung"])
def voice(request):
    (voice,) = read_voices(request.param)
    if voice.synthesizer == "festival":
        try:
            if voice.voice not in Festival().voices():
                pytest.skip("festvox-kdlpc16k is not installed")
        except SynthesisError as error:
            pytest.skip(str(error))
    return voice


def test_a_voice_becomes_a_corpus_with_its_own_phone_times(voice, tmp_path):
    try:
        corpus = write_voice(voice, TEXTS, tmp_path, seed=None)
    except SynthesisError as error:
        pytest.skip(str(error))
    utterances = read_transcribed(corpus)
    assert [u.text for u in utterances] == TEXTS
    assert {u.speaker for u in utterances} == {voice.folder_name}
    aligned = align_corpus(utterances, None)
    for utterance in utterances:
        known = aligned[utterance.name]
        assert known.beams == LABELLED
        length_s = soundfile.info(utterance.sound).duration
        assert known.phones[-1][2] * 0.01 == pytest.approx(length_s, abs=0.02)
    closers = [p for p, _, _ in aligned[utterances[0].name].phones if p in ("P", "B", "M")]
    assert closers == ["P", "B", "B", "B", "B"]


def test_what_was_spoken_already_stays_and_a_seed_varies_the_pace(tmp_path):
    voice = SyntheticVoice("espeak", "en-us")
    try:
        corpus = write_voice(voice, TEXTS[:1], tmp_path, seed=1)
    except SynthesisError as error:
        pytest.skip(str(error))
    sound = corpus / "audio" / "espeak-en-us-0000.flac"
    seconds, written = soundfile.info(sound).duration, sound.stat().st_mtime_ns
    write_voice(voice, TEXTS, tmp_path, seed=2)
    assert sound.stat().st_mtime_ns == written
    plain = write_voice(voice, TEXTS[:1], tmp_path / "plain", seed=None)
    assert soundfile.info(plain / "audio" / sound.name).duration != seconds


def test_a_voice_that_festival_lacks_says_which():
    try:
        festival = Festival()
    except SynthesisError as error:
        pytest.skip(str(error))
    with pytest.raises(SynthesisError, match="no voice 'nobody'; it has: "):
        festival.speak("Hello.", Voice(name="nobody"))
