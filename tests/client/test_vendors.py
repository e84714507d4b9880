"""What synthesisers send, by an example of each as its documentation shows it."""

import json
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_client.protocol import unit_messages
from lipservo_client.vendors import VendorError, VendorUnits, vendor_units
from places import ROOT

ALIGNMENT = {
    "characters": list("Hi Bob."),
    "character_start_times_seconds": [0.0, 0.1, 0.2, 0.25, 0.35, 0.5, 0.6],
    "character_end_times_seconds": [0.1, 0.2, 0.25, 0.35, 0.5, 0.6, 0.7],
}
ELEVENLABS = {"audio_base64": "UklGRg==", "alignment": ALIGNMENT, "normalized_alignment": ALIGNMENT}
HI_BOB = (("Hi", 0.0, 0.2), ("Bob.", 0.25, 0.7))
ELEVENLABS_SOCKET = {
    "audio": "UklGRg==",
    "isFinal": False,
    "normalizedAlignment": None,
    "alignment": {
        "chars": list("Hi Bob."),
        "charStartTimesMs": [0, 100, 200, 250, 350, 500, 600],
        "charDurationsMs": [100, 100, 50, 100, 150, 100, 100],
    },
}
CARTESIA = {
    "type": "timestamps",
    "done": False,
    "status_code": 206,
    "context_id": "872ec12d",
    "word_timestamps": {"words": ["Hi", "Bob."], "start": [0, 0.25], "end": [0.2, 0.7]},
}
CARTESIA_PHONEMES = {
    "type": "phoneme_timestamps",
    "phoneme_timestamps": {"phonemes": ["h", "aɪ"], "start": [0.0, 0.1], "end": [0.1, 0.2]},
}
AZURE_WORDS = [
    {"audioOffset": 0, "duration": 2000000, "text": "Hi", "boundaryType": "Word"},
    {"audioOffset": 2500000, "duration": 4500000, "text": "Bob.", "boundaryType": "Word"},
    {"audioOffset": 7000000, "duration": 10, "text": ".", "boundaryType": "Punctuation"},
]
AZURE_VISEMES = [
    {"audio_offset": 500000, "viseme_id": 12},
    {"audio_offset": 1250000, "viseme_id": 11},
    {"audio_offset": 2000000, "viseme_id": 0},
]
AZURE_SOCKET = json.loads("""{"Metadata": [
  {"Type": "WordBoundary", "Data": {"Offset": 0, "Duration": 2000000,
    "text": {"Text": "Hi", "Length": 2, "BoundaryType": "WordBoundary"}}},
  {"Type": "Viseme", "Data": {"Offset": 500000, "VisemeId": 12, "IsLastAnimation": true}},
  {"Type": "WordBoundary", "Data": {"Offset": 2000000, "Duration": 100,
    "text": {"Text": ".", "Length": 1, "BoundaryType": "PunctuationBoundary"}}}]}""")
POLLY = [
    {"time": 0, "type": "sentence", "start": 0, "end": 7, "value": "Hi Bob."},
    {"time": 0, "type": "word", "start": 0, "end": 2, "value": "Hi"},
    {"time": 6, "type": "viseme", "value": "k"},
    {"time": 73, "type": "viseme", "value": "a"},
    {"time": 250, "type": "word", "start": 3, "end": 6, "value": "Bob"},
]
GOOGLE = {
    "audioContent": "UklGRg==",
    "timepoints": [{"markName": "Hi", "timeSeconds": 0}, {"markName": "Bob", "timeSeconds": 0.25}],
}
PIPER = {
    "sample_rate": 22050,
    "alignments": [
        {"phoneme": "^", "phoneme_ids": [1, 0], "num_samples": 2205},
        {"phoneme": "h", "phoneme_ids": [20, 0], "num_samples": 4410},
    ],
}
KOKORO = {
    "tokens": [
        {"text": "Hi", "phonemes": "hˈI", "whitespace": " ", "start_ts": 0.0, "end_ts": 0.2},
        {"text": "Bob", "phonemes": "bˈɑb", "whitespace": "", "start_ts": 0.25, "end_ts": 0.7},
        {"text": ".", "phonemes": ".", "whitespace": "", "start_ts": None, "end_ts": None},
    ]
}
INWORLD = json.loads("""{"result": {"timestampInfo": {"wordAlignment": {"words": ["Hi"],
  "wordStartTimeSeconds": [0.0], "wordEndTimeSeconds": [0.2], "phoneticDetails": [{"wordIndex": 0,
    "phones": [{"phoneSymbol": "h", "startTimeSeconds": 0, "durationSeconds": 0.1,
      "visemeSymbol": "aei"}]}]}}}}""")
HUME = [
    {"type": "timestamp", "timestamp": {"type": kind, "text": text, "time": time}}
    for kind, text, time in (
        ("word", "Hi", {"begin": 0, "end": 200}),
        ("phoneme", "h", {"begin": 0, "end": 90}),
    )
]
OURS = {"words": [["Hi", 0.0, 0.2]], "phones": [["HH", 0.0, 0.1], ["AY", 0.1, 0.2]]}


def word(*units):
    return VendorUnits("word", units)


def phoneme(alphabet, *units):
    return VendorUnits("phoneme", units, alphabet)


def viseme(alphabet, *units):
    return VendorUnits("viseme", units, alphabet)


HI = word(("Hi", 0.0, 0.2))
STARTS = word(("Hi", 0.0, None), ("Bob", 0.25, None))
TOLD = {
    "elevenlabs": (ELEVENLABS, word(*HI_BOB)),
    "elevenlabs socket": (ELEVENLABS_SOCKET, word(*HI_BOB)),
    "cartesia": (CARTESIA, word(*HI_BOB)),
    "cartesia phonemes": (CARTESIA_PHONEMES, phoneme("ipa", ("h", 0.0, 0.1), ("aɪ", 0.1, 0.2))),
    "azure words": (AZURE_WORDS, word(*HI_BOB)),
    "azure visemes": (
        AZURE_VISEMES, viseme("azure", ("12", 0.05, 0.125), ("11", 0.125, 0.2), ("0", 0.2, None))
    ),
    "azure socket": (AZURE_SOCKET, viseme("azure", ("12", 0.05, None)), HI),
    "polly": (POLLY, viseme("polly", ("k", 0.006, 0.073), ("a", 0.073, None)), STARTS),
    "google": (GOOGLE, STARTS),
    "piper": (PIPER, phoneme("ipa", ("^", 0.0, 0.1), ("h", 0.1, 0.3))),
    "kokoro": (KOKORO, phoneme("misaki", ("hˈI", 0.0, 0.2), ("bˈɑb", 0.25, 0.7)),
               word(("Hi", 0.0, 0.2), ("Bob", 0.25, 0.7))),
    "inworld": (INWORLD, phoneme("ipa", ("h", 0.0, 0.1)), viseme("inworld", ("aei", 0.0, 0.1)), HI),
    "hume": (HUME, phoneme("ipa", ("h", 0.0, 0.09)), HI),
    "ours": (OURS, phoneme("arpabet", ("HH", 0.0, 0.1), ("AY", 0.1, 0.2)), HI),
}  # fmt: skip


@pytest.mark.parametrize("name", TOLD)
def test_each_message_tells_its_units_the_most_precise_first(name):
    message, *told = TOLD[name]
    assert list(vendor_units(message)) == told


def test_every_example_of_the_page_is_read():
    page = (ROOT / "docs" / "text.md").read_text("utf-8")
    block = page.partition("```json\n")[2].partition("```")[0]
    examples = [line for line in block.splitlines() if line and not line.startswith("//")]

    assert len(examples) > 15
    for each in examples:
        assert vendor_units(json.loads(each))[0].units, each


def test_what_a_vendor_sends_is_told_to_a_stream_in_samples():
    words, visemes = vendor_units(CARTESIA)[0], vendor_units(AZURE_VISEMES)[0]

    units = [
        {"label": "Hi", "start_sample": 0, "end_sample": 4800},
        {"label": "Bob.", "start_sample": 6000, "end_sample": 16_800},
    ]
    told = list(unit_messages(words.stream_units(24_000)))
    assert told == [{"type": "words", "units": units}]
    assert words.alphabet is None
    assert visemes.stream_units(24_000)[1][-1] == ("0", 4800, None)


def test_a_piece_of_a_stream_is_counted_from_where_its_sound_begins():
    (words,) = vendor_units(CARTESIA, from_s=2.0)

    assert words.units == (("Hi", 2.0, 2.2), ("Bob.", 2.25, 2.7))


def test_white_space_between_words_is_no_word():
    spaced = {"words": ["Hi", " ", "Bob"], "start": [0, 0.2, 0.3], "end": [0.2, 0.3, 0.7]}

    assert [each.label for each in vendor_units(spaced)[0].units] == ["Hi", "Bob"]


def test_of_a_stream_what_reaches_into_the_next_ends_where_that_begins():
    rows = [{"phoneme": "m", "start": 0.0, "end": 0.3}, {"phoneme": "a", "start": 0.2, "end": 0.4}]

    assert vendor_units(rows)[0].stream_units(1000)[1] == [("m", 0, 200), ("a", 200, 400)]


def test_a_phoneme_without_a_name_is_a_pause_and_not_told():
    rows = [{"phoneme": each, "start": n} for n, each in enumerate(("m", "", " ", "a"))]

    assert vendor_units(rows)[0].stream_units(1000)[1] == [("m", 0, 1000), ("a", 3000, None)]


@pytest.mark.parametrize(
    ("message", "error"),
    [
        ([{"word": "Hi", "start": 1}, {"word": "Bob", "start": 0.5}], "word 2 begins at 0.500 s"),
        ([{"word": "Hi", "start": 1, "end": 0.5}], "[0]: ends at 0.500 s, before it begins"),
        ([{"word": 3, "start": 1}], "[0]: 3 is not a word"),
        ([{"word": "Hi", "start": "soon"}], "[0]: time 'soon' is not a number"),
        ([{"word": "Hi", "start": -1}], "[0]: time -1 must be 0 to 24 hours"),
        ([{"word": "Hi", "start": float("nan")}], "[0]: time nan must be 0 to 24 hours"),
        ([{"phoneme": "m", "num_samples": 9}], "its times are samples, so it needs a sample_rate"),
        ({"words": ["Hi"], "start": [0, 1], "end": [1]}, "lists differ in length: [1, 2, 1]"),
        ([{"word": "a", "start": 0.0}] * 12_001, "more than 12000 words; send them in pieces"),
        ({"words": [["Hi", 0]]}, "words: each row must be [label, start, end]"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line_with_its_place(message, error):
    with pytest.raises(VendorError) as raised:
        vendor_units(message)

    assert error in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "message",
    [{}, "Hi Bob.", {"ssml": "<speak>Hi</speak>"}, {"audio": "UklGRg==", "alignment": None}],
)
def test_a_message_without_times_has_no_units(message):
    assert vendor_units(message) == ()


def characters(text, from_s):
    starts = [round(from_s + 0.1 * n, 7) for n in range(len(text))]
    return {
        "audio": "UklGRg==",
        "alignment": {
            "characters": list(text),
            "character_start_times_seconds": starts,
            "character_end_times_seconds": [round(start + 0.1, 7) for start in starts],
        },
    }


def test_a_word_that_two_messages_share_is_one():
    (words,) = vendor_units([characters("Good mor", 0.0), characters("ning ", 0.8), {"done": True}])

    assert words.units == (("Good", 0.0, 0.4), ("morning", 0.5, 1.2))


def test_starts_that_are_a_little_out_of_order_are_sorted():
    rows = [{"word": "Hi", "start": 0.50001}, {"word": "Bob", "start": 0.5}]

    assert vendor_units(rows)[0].units == (("Bob", 0.5, None), ("Hi", 0.50001, None))


def test_visemes_at_a_kilohertz_are_taken():
    rows = [{"audioOffset": 10_000 * n, "visemeId": n % 22} for n in range(10_000)]

    assert len(vendor_units(rows)[0].units) == 10_000


KEYS = sorted(
    {"time", "type", "value", "audioOffset", "visemeId", "duration", "text", "markName", "words"}
    | {"timeSeconds", "phoneme", "phonemes", "start", "end", "num_samples", "sample_rate", "chars"}
    | {"characters", "character_start_times_seconds", "charStartTimesMs", "charDurationsMs"}
    | {"visemes", "vtimes", "vdurations", "alphabet", "phones", "boundaryType", "start_ts"}
    | {"BlendShapes", "fps", "FrameIndex", "jawOpen"}
)
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
VALUES = LEAVES | st.sampled_from(["viseme", "word", "phoneme"])
for _ in range(3):
    VALUES = (
        VALUES
        | st.lists(VALUES, max_size=4)
        | st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=6)
    )


@given(message=VALUES)
def test_any_message_is_units_in_order_of_time_or_one_line(message):
    try:
        found = vendor_units(message)
    except VendorError as error:
        if "\n" in str(error):
            raise
        return
    for units in found:
        starts_s = [each.start_s for each in units.units]
        assert starts_s == sorted(starts_s)
        assert all(each.end_s is None or each.end_s >= each.start_s for each in units.units)


def test_a_message_nested_without_end_is_refused():
    with pytest.raises(VendorError, match="nested too deep"):
        vendor_units(json.loads("[" * 500 + "]" * 500))


def test_it_needs_the_standard_library_alone():
    script = "import sys, lipservo_client.vendors; print({'numpy', 'websockets'} & {*sys.modules})"
    command = [sys.executable, "-c", script]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)

    assert answer.stdout.strip() == "set()"


def mouth(**weights):
    """A frame of Azure's 55 weights."""
    places = {"jawOpen": 17, "mouthClose": 18, "mouthPucker": 20, "mouthRollLower": 31}
    frame = [0.0] * 55
    for name, weight in weights.items():
        frame[places[name]] = weight
    return frame


def test_blendshapes_are_the_mouths_that_they_look_like():
    frames = [
        *[mouth(jawOpen=0.8)] * 6,
        *[mouth(jawOpen=0.3, mouthClose=0.3)] * 6,
        *[mouth(jawOpen=0.2, mouthPucker=0.8)] * 6,
        *[mouth(jawOpen=0.1, mouthRollLower=0.6)] * 6,
    ]
    expected = [("AA", 1.0, 1.1), ("P", 1.1, 1.2), ("UW", 1.2, 1.3), ("F", 1.3, 1.4)]
    (visemes,) = vendor_units({"FrameIndex": 60, "BlendShapes": frames})

    assert [(v, round(s, 6), round(e, 6)) for v, s, e in visemes.units] == expected
    assert (visemes.kind, visemes.alphabet) == ("viseme", None)
    named = {"fps": 60, "FrameIndex": 60, "blendshapes": [{"jawOpen": 0.8}] * 6}
    assert vendor_units(named)[0].units == (("AA", 1.0, 1.1),)


def test_lips_that_stay_shut_close_rest_and_close_again():
    frames = [mouth()] * 60
    (visemes,) = vendor_units({"BlendShapes": frames})

    assert visemes.units == (("P", 0.0, 0.1), ("SIL", 0.1, 0.9), ("P", 0.9, 1.0))


@pytest.mark.parametrize(
    ("message", "error"),
    [
        ({"BlendShapes": [[0.0] * 50]}, "a frame must have 52 or 55 weights, or weights by name"),
        ({"BlendShapes": [{"jawOpen": 7}]}, "weight 7 of jawopen must be 0 to 1"),
        ({"BlendShapes": [{}], "fps": 1}, "fps must be 10 to 1000"),
        ({"BlendShapes": [{}], "FrameIndex": -1}, "FrameIndex must be a frame's number"),
    ],
)
def test_frames_that_are_none_are_one_line(message, error):
    with pytest.raises(VendorError, match=error):
        vendor_units(message)
