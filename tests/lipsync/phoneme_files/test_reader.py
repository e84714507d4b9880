"""Files of known phonemes: each format by an example, and whatever else somebody may give."""

import json
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from speech import CLIP_LABELS_PATH

from lipsync.errors import UserError
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import labels_in, read_phonemes
from lipsync.phonemes import PHONEMES
from lipsync.recognition.scripted import ScriptedPhonemes
from lipsync.textgrid import LabelError

POLLY = """\
{"time":0,"type":"sentence","start":0,"end":9,"value":"Mary had."}
{"time":6,"type":"word","start":0,"end":4,"value":"Mary"}
{"time":6,"type":"viseme","value":"p"}
{"time":73,"type":"viseme","value":"E"}
{"time":180,"type":"viseme","value":"r"}
{"time":292,"type":"viseme","value":"i"}
{"time":373,"type":"ssml","start":5,"end":8,"value":"mark"}
{"time":373,"type":"viseme","value":"sil"}
"""
AZURE = [
    {"audioOffset": 0, "visemeId": 0},
    {"audioOffset": 500000, "visemeId": 21},
    {"audioOffset": 1250000, "visemeId": 4},
    {"audioOffset": 2000000, "visemeId": 0},
]
HEAD_TTS = {
    "words": ["Mama ", "is"],
    "wtimes": [100, 300],
    "wdurations": [200, 100],
    "visemes": ["PP", "aa", "PP", "aa", "I", "SS"],
    "vtimes": [100, 150, 200, 250, 300, 350],
    "vdurations": [60, 50, 50, 40, 50, 50],
}


def phonemes_in(content, name):
    return labels_in(content, LabelFile(Path(name))).phones


def read(content):
    """Return (phoneme, start in ms, end in ms) of each phoneme in a file's content."""
    if not isinstance(content, str):
        content = json.dumps(content)
    return [
        (each.phoneme, round(1000 * each.start_s), round(1000 * each.end_s))
        for each in phonemes_in(content.encode(), "file")
    ]


def refusal(content):
    with pytest.raises(LabelError) as raised:
        read(content)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def mark(time, viseme):
    return json.dumps({"time": time, "type": "viseme", "value": viseme})


def test_polly_tells_starts_of_visemes_in_ms():
    visemes = [("P", 6, 73), ("EH", 73, 180), ("R", 180, 292), ("IY", 292, 373)]
    assert read(POLLY) == [("SIL", 0, 6), *visemes]


def test_one_speech_mark_alone_is_polly_too():
    """Its end is in no file: a tenth of a second."""
    assert read('{"time":0,"type":"viseme","value":"p"}') == [("P", 0, 100)]


SPELLINGS = ("audioOffset visemeId", "AudioOffset VisemeId", "audio_offset viseme_id")


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_azure_tells_ticks_of_100_ns_in_three_spellings(spelling):
    rows = [dict(zip(spelling.split(), row.values(), strict=True)) for row in AZURE]
    expected = [("SIL", 0, 50), ("P", 50, 125), ("EH", 125, 200)]

    assert read(rows) == expected
    assert read("\n".join(json.dumps(row) for row in rows)) == expected


def test_head_tts_tells_starts_and_durations():
    expected = [
        *(("SIL", 0, 100), ("P", 100, 150), ("AA", 150, 200), ("P", 200, 250), ("AA", 250, 290)),
        *(("SIL", 290, 300), ("IH", 300, 350), ("S", 350, 400)),
    ]
    assert read(HEAD_TTS) == expected
    assert read({"type": "audio", "ref": 1, "data": HEAD_TTS}) == expected


@pytest.mark.parametrize(
    "content",
    [
        [
            {"phoneme": "m", "start": 0.1, "end": 0.2},
            {"phoneme": "ˈaɪ", "start": 0.2, "end": 0.4},
            {"phoneme": "ː", "start": 0.4, "end": 0.45},
            {"phoneme": "tɕ", "start": 0.45, "end": 0.5},
        ],
        {
            "sample_rate": 16000,
            "alignments": [
                {"phoneme": "^", "num_samples": 1600},
                {"phoneme": "m", "num_samples": 1600},
                {"phoneme": "aɪ", "num_samples": 3200},
                {"phoneme": " ", "num_samples": 800},
                {"phoneme": "tɕ", "num_samples": 800},
            ],
        },
        [
            {"phoneme": ",", "duration": 0.1},
            {"phoneme": "M", "duration": 0.1},
            {"phoneme": "AY1", "duration": 0.25},
            {"phoneme": "CH", "duration": 0.05},
        ],
    ],
    ids=["start and end", "samples", "durations"],
)
def test_rows_of_a_phoneme_each_in_ipa_or_arpabet(content):
    assert read(content) == [("SIL", 0, 100), ("M", 100, 200), ("AY", 200, 450), ("CH", 450, 500)]


def test_a_row_of_several_phonemes_shares_its_time():
    rows = [{"phonemes": "hˈɛloʊ", "start_ts": 0.0, "end_ts": 0.4}]
    assert read(rows) == [("HH", 0, 100), ("EH", 100, 200), ("L", 200, 300), ("OW", 300, 400)]


def test_what_align_writes_as_json_is_read():
    tiers = {"words": [["no", 0.1, 0.3]], "phones": [["", 0, 0.1], ["N", 0.1, 0.2]]}
    assert read(tiers) == [("SIL", 0, 100), ("N", 100, 200)]


def test_a_textgrid_is_told_by_its_content(tmp_path):
    copy = tmp_path / "phonemes.json"
    copy.write_bytes(CLIP_LABELS_PATH.read_bytes())

    assert read_phonemes(copy) == read_phonemes(CLIP_LABELS_PATH)


def test_a_file_with_the_mark_of_its_encoding_is_read(tmp_path):
    path = tmp_path / "marks.txt"
    path.write_bytes(b"\xef\xbb\xbf" + POLLY.replace("\n", "\r\n").encode())

    assert len(read_phonemes(path)) == 5


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "file: the file is empty; docs/text.md"),
        ("hello", "file: line 1 is neither labels nor JSON"),
        (POLLY + "nonsense", "file: line 9 is neither labels nor JSON"),
        (POLLY + mark(380, "Q"), "viseme 6 at 0.380 s: 'Q' is not a viseme of polly"),
        (POLLY + mark(272, "p"), "viseme 6 begins at 0.272 s, before"),
        (POLLY + mark("372", "p"), "line 9: time '372' is not a number"),
        ([*AZURE, {"audioOffset": 3000000, "visemeId": 22}], "viseme 5 at 0.300 s: '22' is not"),
        ([*AZURE, {"audioOffset": -1, "visemeId": 1}], "[4]: time -1 must be 0"),
        ([*AZURE, {"audioOffset": 1e99, "visemeId": 1}], "[4]: time 1e+99 must be 0"),
        ([*AZURE, {"audioOffset": True, "visemeId": 1}], "[4]: time True is not a number"),
        (HEAD_TTS | {"vtimes": [1]}, "its lists differ in length: [6, 1, 6]"),
        (HEAD_TTS | {"vtimes": 1}, "its lists differ in length: [6, 1, 6]"),
        (HEAD_TTS | {"visemes": ["PP"] * 5 + ["X"]}, "viseme 6 at 0.350 s: 'X' is not a viseme of"),
        ({"phones": [["AH", 2, 1]]}, "phones: ends at 1.000 s, before it begins"),
        ({"phones": [["AH", 0]]}, "phones: each row must be [label"),
        ({"phones": []}, "no times of words, phonemes"),
        ({"phones": [["", 0, 1]]}, "all labels are silence"),
        ([{"phoneme": "m"}], "no times of words, phonemes"),
        ([{"phoneme": "m", "num_samples": 3}], "so it needs a sample_rate"),
        ([{"phoneme": 3, "start": 0}], "[0]: 3 is not a phoneme"),
        ([1, 2], "no times of words, phonemes"),
        ({"hello": 1}, "no times of words, phonemes"),
        ("[" * 100_000, "line 1 is neither labels nor JSON"),
        ('{"time":' + "9" * 5000 + "}", "nor JSON"),
    ],
)
def test_what_is_wrong_is_told_in_one_line_with_its_place(content, told):
    assert told in refusal(content)


def test_words_alone_are_refused_where_phonemes_are_needed(tmp_path):
    path = tmp_path / "marks.json"
    path.write_text(POLLY.replace("viseme", "note"))

    with pytest.raises(LabelError, match="has words but no phonemes"):
        read_phonemes(path)


NUMBERS = st.one_of(st.integers(-5, 2000), st.floats(), st.none(), st.text(max_size=3))
NUMBERED = ("time", "audioOffset", "VisemeId", "start", "end", "duration", "num_samples")
ROWS = st.fixed_dictionaries(
    {},
    optional={
        **dict.fromkeys(NUMBERED, NUMBERS),
        "type": st.sampled_from(["viseme", "word", 3]),
        "value": st.one_of(st.sampled_from(["p", "sil", "E"]), NUMBERS),
        "phoneme": st.one_of(st.text(max_size=4), st.none()),
    },
)
LISTS = st.lists(st.one_of(st.sampled_from(["PP", "aa"]), NUMBERS), max_size=4)
DOCUMENTS = st.one_of(
    st.lists(ROWS, max_size=6),
    st.fixed_dictionaries({"visemes": LISTS, "vtimes": LISTS, "vdurations": LISTS}),
    st.fixed_dictionaries({"phones": st.lists(LISTS, max_size=4)}),
    st.fixed_dictionaries({"phonemes": st.lists(ROWS, max_size=4), "sample_rate": NUMBERS}),
)


def check_read_or_refused(content):
    """Check that a file is refused in one line, or gives phonemes from 0 s on without gaps."""
    try:
        events = phonemes_in(content, "file")
    except UserError as error:
        if "\n" in str(error):
            raise
        return
    assert events[0].start_s == 0.0
    assert {event.phoneme for event in events} <= set(PHONEMES)
    assert all(event.start_s < event.end_s for event in events)
    assert all(before.end_s == after.start_s for before, after in pairwise(events))
    ScriptedPhonemes(events)


TRACKS = st.from_regex(r"([0-9.]{1,4}\s[0-9.]{1,4}\s[A-Z]{1,2}\n){1,4}")


@given(content=st.binary(max_size=200) | (st.text(max_size=120) | TRACKS).map(str.encode))
def test_no_bytes_break_the_reader(content):
    check_read_or_refused(content)


@example(document=[{"type": "viseme", "phoneme": "??A", "start": 1}])
@given(document=DOCUMENTS)
def test_no_document_breaks_the_reader(document):
    check_read_or_refused(json.dumps(document).encode())


@given(rows=st.lists(ROWS, max_size=6))
def test_no_lines_break_the_reader(rows):
    check_read_or_refused("\n".join(json.dumps(row) for row in rows).encode())


@given(garbage=st.text(max_size=60), place=st.integers(0, 400))
def test_no_textgrid_breaks_the_reader(tmp_path_factory, garbage, place):
    text = CLIP_LABELS_PATH.read_text("utf-8")[:600]
    path = tmp_path_factory.mktemp("grid") / "broken.TextGrid"
    path.write_text(text[:place] + garbage + text[place:], "utf-8", errors="replace")
    try:
        read_phonemes(path)
    except UserError as error:
        if "\n" in str(error) and not {"\n", "\r"} & set(garbage):
            raise
