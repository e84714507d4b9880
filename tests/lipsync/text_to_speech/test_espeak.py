"""espeak-ng through its library: what it says, and what it does with odd texts."""

import ctypes
import os
import signal
import subprocess
import sys
import threading

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from spoken_phonemes import check_spoken, closures

from lipsync.text_to_speech import espeak_library
from lipsync.text_to_speech.espeak import Espeak
from lipsync.text_to_speech.espeak_process import EspeakProcess
from lipsync.text_to_speech.synthesis import SynthesisError, UnspeakableTextError, Voice

#: Said in its own words by nearly every voice.
NUMBERS = "0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 37 100 1000"


@pytest.fixture(scope="module")
def espeak():
    return Espeak()


def phonemes(spoken):
    return " ".join(each.phoneme for each in spoken.phonemes)


def test_a_sentence_is_said_phoneme_by_phoneme(espeak):
    spoken = espeak.speak("Thumbs up!")

    check_spoken(spoken)
    assert phonemes(spoken) == "SIL TH AH M Z AH P SIL"
    assert [each.text for each in spoken.words] == ["Thumbs", "up"]
    assert spoken.words[1].start_s == spoken.phonemes[5].start_s
    assert spoken.words[1].end_s == spoken.phonemes[6].end_s
    assert spoken.guessed == ()


@pytest.mark.parametrize(
    ("language", "text", "words"),
    [
        ("ja", "こんにちは世界、今日はいい天気です", ["こんにちは世界", "今日はいい天気です"]),
        ("th", "สวัสดีชาวโลก", ["สวัสดีชาวโลก"]),
        # The espeak-ng of the extra `say` leaves out the second syllable of 你好.
        ("cmn", "你,天气", ["你", "天", "气"]),
        ("ko", "안녕하세요 세계", ["안녕하세요", "세계"]),
        ("ar", "مرحبا بالعالم", ["مرحبا", "بالعالم"]),
        ("he", "שלום עולם", ["שלום", "עולם"]),
        ("ru", "Привет, мир", ["Привет", "мир"]),
        ("hi", "नमस्ते दुनिया", ["नमस्ते", "दुनिया"]),
        ("en-us", "In 1984 no no", ["In", "1984", "no", "no"]),
    ],
)
def test_each_word_of_any_script_is_told_once(espeak, language, text, words):
    spoken = espeak.speak(text, Voice(language))

    assert [each.text for each in spoken.words] == words
    starts_s = [each.start_s for each in spoken.words]
    assert starts_s == sorted(set(starts_s))
    assert spoken.words[-1].end_s > spoken.duration_s - 0.5


@pytest.mark.parametrize(
    ("text", "language", "said"),
    [
        # espeak-ng gives the L of "twelve" and the V the same sample: V has a share of it.
        ("twelve", "en-us", "T W EH L V SIL"),
        ("über Köln", "de", "UW B ER K AO L N SIL"),
        ("le weekend", "fr-fr", "L AH W IY K EH N D SIL"),  # a switch of language is no phoneme
    ],
)
def test_every_language_has_its_own_phonemes_in_ours(espeak, text, language, said):
    assert phonemes(espeak.speak(text, Voice(language))) == said


def test_a_slower_voice_takes_longer_and_a_higher_one_sounds_otherwise(espeak):
    plain = espeak.speak("a baby")

    assert espeak.speak("a baby", Voice(rate_wpm=90)).duration_s > 1.3 * plain.duration_s
    assert (espeak.speak("a baby", Voice(pitch=90)).samples[:9999] != plain.samples[:9999]).any()


def test_the_same_text_gives_the_same_phonemes_after_another_language(espeak):
    first = espeak.speak("a baby")
    espeak.speak("ein Baby", Voice("de", rate_wpm=300, pitch=10))
    again = espeak.speak("a baby")

    assert phonemes(again) == phonemes(first)
    # Not to the sample: the library goes on in its voice's last period, and lengthens a last vowel.
    for one, other in zip(first.phonemes[:-1], again.phonemes[:-1], strict=True):
        assert one.start_s == pytest.approx(other.start_s, abs=0.01)


@pytest.mark.parametrize("text", ["", "  \n\t", "\x00\x01\x1b", "\ud83d", "—", "..."])
def test_a_text_in_which_nothing_can_be_spoken_is_one_line(espeak, text):
    with pytest.raises(UnspeakableTextError) as raised:
        espeak.speak(text)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<speak>no</speak>", "S P IY K"),  # the word, not the mark
        ("[[tEst]] no", "N OW"),  # no phonemes of espeak-ng's own
        ("\N{GRINNING FACE} no", "N OW"),
        ("no\x01+50S\x00way", "W EY"),  # no commands within the text
        ("no \ud800 way", "W EY"),
        ("<audio src='/etc/passwd'/> no", "N OW"),
    ],
)
def test_text_is_text_whatever_it_looks_like(espeak, text, said):
    spoken = espeak.speak(text)

    check_spoken(spoken)
    assert said in phonemes(spoken)


@pytest.mark.parametrize(
    ("voice", "told"),
    [
        (Voice("en-uz"), "en-us"),
        (Voice("\x00"), "similar languages"),
        (Voice(name="kal"), "give a language"),
        (Voice(rate_wpm=79), "80 to 400"),
        (Voice(rate_wpm=401), "80 to 400"),
        (Voice(pitch=-1), "0 to 99"),
    ],
)
def test_a_voice_that_it_lacks_is_one_line(espeak, voice, told):
    with pytest.raises(SynthesisError, match=told) as raised:
        espeak.speak("hello", voice)
    assert "\n" not in str(raised.value)


def test_a_text_that_is_too_long_at_once_is_refused_before_it_is_spoken(espeak):
    with pytest.raises(SynthesisError, match="1000000 characters"):
        espeak.speak("a" * 1_000_000)


def test_two_threads_each_get_their_own_text(espeak):
    texts = ("papa mama", "thumbs up")
    alone = {text: phonemes(espeak.speak(text)) for text in texts}
    wrong = []

    def speak_often(text):
        wrong.extend(1 for _ in range(20) if phonemes(espeak.speak(text)) != alone[text])

    threads = [threading.Thread(target=speak_often, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_a_text_at_which_espeak_ng_dies_costs_no_other():
    process = EspeakProcess()
    process.synthesize("a baby", Voice())
    os.kill(process.pid, signal.SIGSTOP)
    threading.Timer(0.2, os.kill, (process.pid, signal.SIGKILL)).start()

    with pytest.raises(SynthesisError, match="unusual characters"):
        process.synthesize("a baby", Voice())
    assert process.synthesize("a baby", Voice()).marks
    process.close()


def test_a_missing_library_is_one_line_that_names_the_package(monkeypatch):
    def missing(name):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", missing)
    monkeypatch.setattr(espeak_library, "find_spec", {}.get)
    with pytest.raises(SynthesisError) as raised:
        espeak_library.load_library()
    assert str(raised.value) == (
        "espeak-ng is not installed: `apt install espeak-ng`, or `pip install 'lipservo[say]'`"
    )


def spoken_if_speakable(text, voice):
    try:
        return Espeak().speak(text, voice)
    except SynthesisError as error:
        if "\n" in str(error):
            raise
        return None


#: The C library of espeak-ng 1.51 ends the process that speaks this.
CRASHES = "\u0e58-\u0248"


@settings(max_examples=50, deadline=None)
@example(text=CRASHES, language="hi")
@given(text=st.text(max_size=80), language=st.sampled_from(["en-us", "de", "ru", "hi", "cmn"]))
def test_any_text_is_spoken_or_refused_in_one_line(text, language):
    spoken = spoken_if_speakable(text, Voice(language))
    if spoken is not None:
        check_spoken(spoken)
        assert all(end_s - start_s >= 0.02 for start_s, end_s in closures(spoken)[1:])


@pytest.mark.parametrize("language", ["cs", "fr-fr", "sv", "ka", "vi", "cmn", "ar"])
def test_every_phoneme_of_a_language_is_in_the_table(espeak, language):
    spoken = espeak.speak(NUMBERS, Voice(language))
    check_spoken(spoken)
    assert spoken.guessed == ()


@pytest.mark.slow
def test_every_phoneme_of_every_language_is_in_the_table(espeak):
    silent = set()
    for language in espeak.languages():
        try:
            spoken = espeak.speak(NUMBERS, Voice(language))
        except UnspeakableTextError:
            silent.add(language)
        else:
            check_spoken(spoken)
            assert spoken.guessed == (), language
    # Voices without numbers in their dictionaries.
    assert len(silent) < 12


WITHOUT_DEBIANS = """
import ctypes
system = ctypes.CDLL
def without(name, *rest, **options):
    if name == "libespeak-ng.so.1":
        raise OSError(name)
    return system(name, *rest, **options)
ctypes.CDLL = without
from lipsync.text_to_speech.espeak import Espeak
print(" ".join(each.phoneme for each in Espeak().speak("Thumbs up!").phonemes))
"""


def test_where_the_debian_package_is_missing_the_extra_serves():
    """In a process of its own, as the library has one state."""
    pytest.importorskip("espeakng_loader", reason="the extra `say` is not installed")
    command = [sys.executable, "-c", WITHOUT_DEBIANS]
    done = subprocess.run(command, capture_output=True, text=True, check=False)

    assert done.stdout == "SIL TH AH M Z AH P SIL\n", done.stderr
