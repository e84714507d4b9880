"""Rhubarb's mouth shapes from phonemes, and its file formats."""

import json
from itertools import pairwise
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.export.mouth_cues import SHAPES, cues_json, cues_tsv, cues_xml, rule_cues
from lipsync.phonemes import PHONEMES, PhonemeEvent


def events(*phones):
    """Return events of (phoneme, duration in s), such as ("AA", 0.2), end to end from 0 s."""
    joined, now_s = [], 0.0
    for phoneme, duration_s in phones:
        joined.append(PhonemeEvent(phoneme, now_s, now_s + duration_s))
        now_s += duration_s
    return joined


def drawn(*phones, **options):
    """The shapes as `SHAPE start-end` in hundredths of a second."""
    said = events(*phones)
    cues = rule_cues(said, said[-1].end_s, **options)
    return [f"{cue.shape} {cue.start_cs}-{cue.end_cs}" for cue in cues]


def test_hi_is_drawn_as_in_rhubarbs_readme():
    """HH anticipates the wide AY; its end is B; C lies between D and B; the rest is X."""
    said = [PhonemeEvent("HH", 0.05, 0.08), PhonemeEvent("AY", 0.08, 0.43)]
    assert cues_tsv(rule_cues(said, 0.47)) == (
        "0.00\tX\n0.05\tD\n0.27\tC\n0.31\tB\n0.43\tX\n0.47\tX\n"
    )


@pytest.mark.parametrize(
    ("phone", "shape"),
    [
        ("M", "A"), ("P", "A"), ("B", "A"), ("IY", "B"), ("EH", "C"), ("AE", "C"), ("AA", "D"),
        ("AO", "E"), ("ER", "E"), ("UW", "F"), ("W", "F"), ("F", "G"), ("V", "G"), ("L", "H"),
    ],
)  # fmt: skip
def test_phones_have_the_shapes_that_rhubarb_names_for_them(phone, shape):
    # A long phone between open vowels that are far from it.
    around = ("EH", 0.3) if shape != "C" else ("UW", 0.3)
    cues = rule_cues(events(around, (phone, 0.3), around), 0.9)
    assert [cue.shape for cue in cues if cue.start_cs <= 45 < cue.end_cs] == [shape]


def test_a_vowel_is_anticipated_by_the_consonants_before_it():
    assert drawn(("AA", 0.3), ("T", 0.1), ("UW", 0.3)) == ["D 0-26", "E 26-34", "F 34-70"]


def test_a_closure_too_short_to_be_seen_begins_earlier():
    cues = drawn(("AA", 0.3), ("M", 0.03), ("AA", 0.3))
    assert cues == ["D 0-17", "C 17-25", "A 25-33", "D 33-63"]


def test_stops_that_are_labelled_at_their_burst_close_before_their_label():
    said = (("EH", 0.2), ("P", 0.08), ("EH", 0.2))
    assert drawn(*said) == ["C 0-20", "A 20-28", "C 28-48"]
    assert drawn(*said, stops_at_burst=True) == ["C 0-10", "A 10-20", "C 20-48"]


@pytest.mark.parametrize(
    ("pause_s", "at_cs", "shape"),
    [(0.10, 31, "D"), (0.30, 45, "C"), (0.50, 55, "X")],
    ids=["held", "relaxed", "closed"],
)
def test_a_pause_holds_relaxes_or_closes_the_mouth_by_its_length(pause_s, at_cs, shape):
    said = [("AA", 0.3), ("SIL", pause_s), ("M", 0.3)]
    cues = rule_cues(events(*said), 0.6 + pause_s)
    assert [c.shape for c in cues if c.start_cs <= at_cs < c.end_cs] == [shape]


SPOKEN = st.tuples(st.sampled_from(PHONEMES), st.integers(1, 60))


@given(st.lists(SPOKEN, min_size=1, max_size=40), st.booleans())
def test_cues_cover_any_speech_without_a_gap_and_lips_close_for_every_p_b_m(phones, at_burst):
    said = events(*((phone, cs / 100) for phone, cs in phones))
    duration_s = said[-1].end_s
    cues = rule_cues(said, duration_s, stops_at_burst=at_burst)
    assert cues[0].start_cs == 0
    assert cues[-1].end_cs == round(duration_s * 100)
    assert all(a.end_cs == b.start_cs and a.shape != b.shape for a, b in pairwise(cues))
    assert {cue.shape for cue in cues} <= set(SHAPES)
    if not at_burst:
        for event in said:
            if event.phoneme in ("P", "B", "M"):
                start_cs, end_cs = round(event.start_s * 100), round(event.end_s * 100)
                within = [c for c in cues if c.start_cs < end_cs and c.end_cs > start_cs]
                assert {"A", "X"} & {cue.shape for cue in within}, event


def test_the_three_formats_say_the_same():
    said = [PhonemeEvent("M", 0.10, 0.20), PhonemeEvent("AA", 0.20, 0.40)]
    cues = rule_cues(said, 0.456)
    rows = [tuple(line.split("\t")) for line in cues_tsv(cues).splitlines()]
    assert rows[-1] == ("0.46", "X")
    told = json.loads(cues_json(cues, 'a "b"&<c>.wav', 0.456))
    assert told["metadata"] == {"soundFile": 'a "b"&<c>.wav', "duration": 0.45}
    root = ElementTree.fromstring(cues_xml(cues, 'a "b"&<c>.wav', 0.456))
    assert root.findtext("metadata/soundFile") == 'a "b"&<c>.wav'
    in_xml = [(c.get("start"), c.get("end"), c.text) for c in root.findall("mouthCues/mouthCue")]
    assert [(start, shape) for start, _, shape in in_xml] == rows[:-1]
    in_json = [(f"{c['start']:.2f}", f"{c['end']:.2f}", c["value"]) for c in told["mouthCues"]]
    assert in_json == in_xml


@pytest.mark.parametrize("name", ["caf\udce9.wav", "a\x01.wav", "a\uffff.wav"])
def test_a_name_that_xml_cannot_hold_is_written_with_a_question_mark(name):
    written = cues_xml([], name, 0.5).encode()
    told = ElementTree.fromstring(written).findtext("metadata/soundFile")
    assert told == "".join(letter if letter.isascii() and letter >= " " else "?" for letter in name)
