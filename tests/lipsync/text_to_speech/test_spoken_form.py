"""Texts as language models write them: what is said of each, word by word."""

import re
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipservo.agents.messages import Words, spoken_text_of
from lipsync.text_to_speech.pronunciation import pronounced
from lipsync.text_to_speech.spoken_form import spoken_form
from lipsync.text_to_speech.synthesis import SynthesizedSpeech
from lipsync.text_to_speech.synthesizers import speak_in_pieces


class Recorded:
    """A voice that keeps what it is given."""

    longest_text = 1000

    def __init__(self):
        self.texts = []

    def speak(self, text, _voice):
        self.texts.append(text)
        return SynthesizedSpeech(np.zeros(1, np.float32), 16_000, (), ())


#: Kinds of mark-up: what a model wrote, and what a person reads out of it.
KINDS = {
    "bold": ("**Hello** there.", "Hello there."),
    "italic": ("It is *really* _nice_.", "It is really nice."),
    "bold italic": ("***Stop*** now.", "Stop now."),
    "underlined": ("__Stop__ now.", "Stop now."),
    "struck out": ("It costs ~~ten~~ nine.", "It costs nine."),
    "heading": ("# Good news\nYou won.", "Good news You won."),
    "small heading": ("### Step two ###\nWait.", "Step two Wait."),
    "underlined heading": ("Good news\n=========\nYou won.", "Good news You won."),
    "bullets": ("- bread\n* butter\n+ jam", "bread butter jam"),
    "round bullets": ("• bread\n• butter", "bread butter"),
    "numbers of a list": ("1. bread\n2. butter", "bread butter"),
    "a year is no list": ("1984. A good year.", "1984. A good year."),
    "nested list": ("- bread\n  - white\n    1. thin", "bread white thin"),
    "tasks": ("- [x] bread\n- [ ] butter", "bread butter"),
    "link": ("See [the manual](https://a.example/x?y=1#z).", "See the manual."),
    "link by reference": ("See [the manual][1].\n\n[1]: https://a.example", "See the manual."),
    "bare link": ("See https://www.robots.example/a/b?c=d.", "See robots dot example."),
    "link in angles": ("See <https://robots.example/a>.", "See robots dot example."),
    "mail": ("Write to bob@robots.example.", "Write to bob at robots dot example."),
    "picture": ("Look: ![a cat](cat.png)", "Look"),
    "inline code": ("Press `Enter` twice.", "Press Enter twice."),
    "code block": ("So:\n```python\nprint(1)\n```\nDone.", "So: Done."),
    "quotation": ("> Be quick.\n> Be kind.", "Be quick. Be kind."),
    "rule": ("Yes.\n\n---\n\nNo.", "Yes. No."),
    "table": ("| name | age |\n|:--|--:|\n| Bob | 3 |", "name, age Bob, 3"),
    "escapes": (r"\*not bold\* and \_so\_ on", "not bold and so on"),
    "entities": ("Salt &amp; pepper&nbsp;please", "Salt and pepper please"),
    "HTML": ("<p>Hello<br>there</p><!-- no -->", "Hello there"),
    "emoji": ("Hi 👋🏽 there 👨‍👩‍👧 😀!", "Hi there!"),
    "smileys": ("Hi :-) there ;) you :D <3 ^^", "Hi there you"),
    "short codes": ("Hi :wave: there :thumbs_up:", "Hi there"),
    "shrug": ("Who knows ¯\\_(ツ)_/¯", "Who knows"),
    "hashtags": ("So #robots and @anna", "So robots and anna"),
    "footnote": ("It works[^1].\n\n[^1]: See there.", "It works."),
    "citations": ("It works [1][2, 3]【4†source】.", "It works."),
    "stage directions": ("[laughs softly] Well. [pause] No.", "Well. No."),
    "thoughts": ("<think>He is sad.</think>Hello.", "Hello."),
    "front matter": ("---\ntitle: x\n---\nHello.", "Hello."),
    "rules around a paragraph": ("---\nWell.\n\n---\nNo.", "Well. No."),
    "SSML pause at a line's end": ('1. so <break time="1s"/>\n2. well', "so well"),
    "formula": ("So $$E = mc^2$$ and \\(a_1\\) hold.", "So and hold."),
    "SSML pause": ('Wait <break time="1s"/> here.', "Wait; here."),
    "SSML pace": ('<speak><prosody rate="slow">Go on.</prosody></speak>', "Go on."),
    "SSML stress": ('It is <emphasis level="strong">you</emphasis>.', "It is you."),
    "SSML alias": ('The <sub alias="United Nations">UN</sub> met.', "The United Nations met."),
    "SSML letters": ('<say-as interpret-as="characters">AB</say-as>', "A B"),
    "times": ("At 10:30, 9:05 am or 14:00.", "At 10 30, 9 oh 5 A M or 14 o'clock."),
    "ranges of times": ("9:00am-5:00pm, 9-10:30, 14:00 – 15:30, 10 - 5 = 5", "9 A M to 5 P M, "
                        "9 to 10 30, 14 o'clock to 15 30, 10 - 5 = 5"),
    "money": ("$5, $3.50, $1, €2.5 million, £1,200", "5 dollars, 3 dollars 50 cents, 1 dollar, "
              "2.5 million euros, 1,200 pounds"),
    "short scales": ("$5M, $1.25m, £3bn, $5 baked", "5 million dollars, 1.25 million dollars, "
                     "3 billion pounds, 5 dollars baked"),
    "two prices": ("A costs $10 (limit=5), B $20. $E=mc^2$ holds", "A costs 10 dollars (limit=5), "
                   "B 20 dollars. holds"),
    "arithmetic": ("2*3*4, 5 - 3 = 2, $9 - $5 = $4, 10 - 5 - 3 = 2", "2 times 3 times 4, "
                   "5 - 3 = 2, 9 dollars - 5 dollars = 4 dollars, 10 - 5 - 3 = 2"),
    "no arithmetic": ("80-89 = B, 2019 - 2021, $20 - 5 users, Qwen2.5-7B", "80 to 89 = B, "
                      "2019 to 2021, 20 dollars - 5 users, Qwen2.5 7B"),
    "spaced formula": ("Area is $ x^2 = 4 $ here", "Area is here"),
    "wide ranges": ("1.5-2 hours, 1,000-2,000, $5-$10, 555-1234", "1.5 to 2 hours, 1,000 to 2,000, "
                    "5 dollars to 10 dollars, 555 1234"),
    "dates": ("On 2026-11-29.", "On November 29, 2026."),
    "ranges": ("5-10 people, 2019–2024", "5 to 10 people, 2019 to 2024"),
    "telephone": ("Call 555-1234.", "Call 555 1234."),
    "signs": ("~5 & 2*3, C# or #1, and/or", "about 5 and 2 times 3, C sharp or number 1, and or"),
    "arrows": ("Here -> there → away", "Here there away"),
    "names with lines": ("the file my_long_name", "the file my long name"),
}  # fmt: skip


def words(text):
    return " ".join(text.split())


@pytest.mark.parametrize("kind", KINDS)
def test_of_each_kind_of_markup_only_the_words_are_said(kind):
    written, expected = KINDS[kind]

    assert words(spoken_form(written)).removesuffix(":") == expected
    assert words(spoken_form(spoken_form(written))) == words(spoken_form(written))


@pytest.mark.parametrize(
    "text",
    [
        "Hello, Mr. Smith! It's half-past nine; isn't it?",
        "He paid a lot: too much.",
        "Es ist schön, daß du da bist.",
        "今日は。",
        "20 % of 1,234.5 is 3rd; 20 °C (or so).",
        "2 + 2 = 4",
    ],
)
def test_plain_words_are_said_as_they_are(text):
    assert spoken_form(text) == text


@pytest.mark.parametrize("kind", ["bold", "link", "emoji", "times", "money", "SSML alias", "table"])
def test_voice_mouth_and_captions_have_the_same_words(kind):
    """What the voice is given, and what is told beside a sound, pronounced word by word."""
    written, expected = KINDS[kind]
    voice = Recorded()
    list(speak_in_pieces(voice, written))
    told = [word.label.lower() for word in pronounced(written)]

    spoken = " ".join(voice.texts)
    assert words(spoken) == expected
    if not any(map(str.isdigit, spoken)):
        assert told == re.findall(r"[a-z']+", spoken.lower())
    assert not {"asterisk", "hash", "slash", "colon", "pipe", "underscore"} & set(told)


def test_words_with_times_are_shown_as_they_are_said():
    units = [
        {"label": each, "start_sample": 1000 * n}
        for n, each in enumerate(["**Hello**", ":-)", "_dear_", "👋", "friend"])
    ]
    message = Words(type="words", units=units)

    spoken = [(each.label, each.start_sample) for each in spoken_text_of(message, 16_000).units]
    assert spoken == [("Hello", 0), ("dear", 2000), ("friend", 4000)]


def test_figures_of_other_languages_are_left_to_their_voice():
    assert spoken_form("Um **10:30** kostet es 5-10 €", "de") == "Um 10:30 kostet es 5-10 €"


def test_nothing_is_said_of_marks_alone():
    marks = ["😀", "***", "---", "```\nx = 1\n```", "[laughs]", ":-)", ""]
    assert {spoken_form(each) for each in marks} == {""}


@pytest.mark.parametrize(
    "text",
    [
        "$" + "_" * 20_000,
        "$ " + "_ " * 10_000,
        "\\[" * 10_000,
        "\\(" * 10_000,
        "\n" * 20_000 + "1",
        "," * 20_000 + "1",
        "1." * 10_000,
        "<sub alias='" * 1_700,
        '<say-as "verbatim"' * 1_100,
        "[^" * 10_000,
    ],
    ids=lambda text: repr(text[:20]),
)
def test_no_text_holds_the_interpreter_so_long_that_a_face_stops(text):
    """No other thread runs in a regular expression, and a face is ended after 3 s of silence."""
    began_s = time.process_time()
    spoken_form(text)
    assert time.process_time() - began_s < 1.5


@given(st.lists(st.sampled_from([text for text, _ in KINDS.values()]), min_size=1, max_size=4))
def test_marks_never_stay(parts):
    """However the kinds stand together."""
    assert not re.search(r"[*_`#|\\^{}<>~【】]|://", spoken_form("\n\n".join(parts)))


@given(st.text(max_size=200))
def test_no_text_breaks_it(text):
    assert isinstance(spoken_form(text), str)
