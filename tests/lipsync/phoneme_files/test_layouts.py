"""Label files of aligners, recognisers and editors: an example of each, and what people do."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from label_files import (
    OF_PHONES,
    OF_WORDS,
    PHONES,
    RHUBARB,
    RHUBARB_PHONES,
    SOUND_S,
    VOICEVOX,
    VOICEVOX_PHONES,
    WORDS,
    labelled,
    textgrid,
)
from lipservo_client.alphabet import ARPABET_PHONES, ASCII_IPA, alphabet_of
from praatio import textgrid as praatio_textgrid

from lipsync.alphabets import phones_of
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import labels_in, read_labels
from lipsync.phonemes import PHONEMES
from lipsync.textgrid import LabelError

#: Texts that a person makes out of a good one, and what the one line has to name.
LABEL_TRACK = OF_PHONES["Audacity"][1]
CSV = OF_PHONES["MFA's CSV"][1]
GRID = OF_PHONES["Praat's TextGrid"][1]


def read(content, tier="", alphabet="", sound_s=SOUND_S):
    content = content.encode() if isinstance(content, str) else content
    return labels_in(content, LabelFile(Path("file"), tier, alphabet), sound_s)


def told(content, **choice):
    """(phone, start and end in ms) of what is said, without silences."""
    return rounded((e.phoneme, e.start_s, e.end_s) for e in read(content, **choice).phones)


def rounded(rows):
    return [(x, round(1e3 * s, 1), round(1e3 * e, 1)) for x, s, e in rows if x != "SIL"]


def refusal(content, **choice):
    with pytest.raises(LabelError) as raised:
        read(content, **choice)
    assert "\n" not in str(raised.value)
    return str(raised.value)


@pytest.mark.parametrize("name", OF_PHONES)
def test_each_format_tells_the_same_phones(name):
    assert told(OF_PHONES[name][1]) == rounded(PHONES)
    assert read(OF_PHONES[name][1]).notes == ()


@pytest.mark.parametrize("name", OF_WORDS)
def test_recognisers_of_words_tell_the_words(name):
    labels = read(json.dumps(OF_WORDS[name]))

    assert [(w.label.strip(), w.start_s, w.end_s) for w in labels.words] == list(WORDS)
    assert labels.phones == ()


@pytest.mark.parametrize("name", RHUBARB)
def test_shapes_of_rhubarb_are_visemes(name):
    assert told(RHUBARB[name][1]) == rounded(RHUBARB_PHONES)


def test_voicevox_tells_lengths_at_a_speed_of_one():
    assert told(VOICEVOX, sound_s=0.6) == rounded(VOICEVOX_PHONES)


def test_the_short_form_of_praat_and_its_utf_16_are_read(tmp_path):
    """Both written by praatio, an independent writer."""
    (path := tmp_path / "long.TextGrid").write_text(GRID)
    grid = praatio_textgrid.openTextgrid(str(path), includeEmptyIntervals=True)
    grid.save(str(tmp_path / "short.TextGrid"), format="short_textgrid", includeBlankSpaces=True)
    grid.save(str(tmp_path / "grid.json"), format="textgrid_json", includeBlankSpaces=True)
    (tmp_path / "wide.TextGrid").write_bytes(GRID.encode("utf-16"))

    for name in ("short.TextGrid", "grid.json", "wide.TextGrid"):
        assert told((tmp_path / name).read_bytes()) == rounded(PHONES), name


def test_the_client_knows_the_phones_of_the_inventory():
    assert set(ARPABET_PHONES) == set(PHONEMES) - {"SIL"}


@pytest.mark.parametrize("label", sorted(ASCII_IPA))
def test_ipa_of_two_ascii_letters_is_spelled_without_a_guess(label):
    assert phones_of(label, "ipa", guesses=False)


@pytest.mark.parametrize(
    ("labels", "alphabet"),
    [
        (("hh", "ah", "l", "ow"), "arpabet"),
        (("HH", "AH0", "sil", "spn", ""), "arpabet"),
        (("ah_B", "m_E", "SIL"), "arpabet"),
        (("h", "ə", "ow"), "ipa"),
        (("m", "y"), "ipa"),
        (("M", "Y"), "arpabet"),
        (("tʃ", "aj", "ts"), "ipa"),
    ],
)
def test_an_alphabet_is_decided_by_all_labels(labels, alphabet):
    assert alphabet_of([(label, 0.0, 1.0) for label in labels]) == alphabet


@given(
    phones=st.lists(st.sampled_from(sorted(ARPABET_PHONES)), min_size=1, max_size=9),
    stress=st.sampled_from(["", "0", "1", "2"]),
)
def test_arpabet_is_the_same_in_any_case(phones, stress):
    def rows(label):
        spelt = [[label(p), n / 10, n / 10 + 0.1] for n, p in enumerate(phones)]
        return json.dumps({"phones": spelt})

    upper = told(rows(lambda phone: phone + stress), sound_s=None)
    assert upper == rounded((p, n / 10, n / 10 + 0.1) for n, p in enumerate(phones))
    if any(len(phone) > 1 for phone in phones):
        assert told(rows(str.lower), sound_s=None) == upper
        assert told(rows(str.title), sound_s=None) == upper


@pytest.mark.parametrize(
    ("label", "rest"),
    [
        ("dcl", ("is neither", "name its alphabet (--alphabet")),
        ("hello", ("is neither", "(--tier words)")),
        ("zz", ("is neither", "--alphabet")),
        ("ж", ("is not a phoneme of ipa",)),
    ],
)
def test_ascii_words_are_never_spelled_as_ipa_and_no_letter_is_guessed(label, rest):
    rows = labelled(("h", "ə", "l", label, "m", "ɑ", "p", "i"))
    error = refusal(textgrid({"phones": rows}))

    assert f"phoneme 5 at 0.450 s: '{label}' {rest[0]}" in error
    assert rest[-1] in error


def test_two_speakers_are_told_apart_by_tier():
    other = [(label, start_s, end_s) for label, start_s, end_s in PHONES[:4]]
    grid = textgrid({"ann - words": WORDS, "ann - phones": PHONES, "bob - phones": other})

    assert "ann - phones, bob - phones; choose one with --tier NAME" in refusal(grid)
    assert told(grid, tier="bob - phones") == rounded(other)
    assert "the file has no tier 'eve', but ann - words" in refusal(grid, tier="eve")


def test_a_tier_of_any_name_is_read_if_it_is_the_only_one():
    assert told(textgrid({"Mary": PHONES})) == rounded(PHONES)
    error = refusal(textgrid({"Mary": PHONES, "notes": WORDS}))
    assert "the file has several tiers: Mary, notes; choose one with --tier NAME" in error


def test_words_of_a_label_track_are_words_where_somebody_says_so():
    track = "".join(f"{start}\t{end}\t{word}\n" for word, start, end in WORDS)

    assert "'hello' is neither ARPAbet nor IPA" in refusal(track)
    assert "--tier words" in refusal(track)
    assert [w.label for w in read(track, tier="words").words] == ["hello", "mappy"]


def test_what_an_aligner_could_not_spell_is_told():
    rows = labelled(("HH", "AH0", "L", "OW1", "spn", "sp", "sil", "IY1"))

    assert read(textgrid({"phones": rows})).notes == (
        "stretches not spelt by the aligner, where the mouth rests: 1",
    )


def test_words_without_a_time_are_passed_over_with_a_line():
    words = [
        {"word": "hello", "start": 0.1, "end": 0.65},
        {"word": "42"},
        {"word": "mappy", "start": 0.8, "end": 1.6},
    ]
    labels = read(json.dumps({"segments": [{"start": 0.1, "end": 1.6, "words": words}]}))

    assert [w.label for w in labels.words] == ["hello", "mappy"]
    assert labels.notes == ("word '42' has no time; it is passed over",)


WITH_PAUSE = ("HH", "AH", "L", "OW", "SIL", "M", "AA", "P", "IY")


@given(shift_s=st.floats(-0.0009, 0.0009))
def test_edges_closer_than_a_millisecond_are_one(shift_s):
    track = "".join(f"{s!r}\t{e + shift_s!r}\t{label}\n" for label, s, e in PHONES)
    events = read(track).phones

    # One silence before, one between the words, and no other.
    assert [e.phoneme for e in events] == ["SIL", *WITH_PAUSE]
    moved_s = [e.start_s - s for e, (_, s, _) in zip(events[1:5], PHONES[:4], strict=True)]
    assert np.abs(moved_s).max() < 0.001


def test_an_overlap_is_refused_with_tier_time_and_labels():
    before, after = GRID.split("xmin = 0.35\n            xmax = 0.45")
    grid = f"{before}xmin = 0.3\n            xmax = 0.45{after}"

    assert refusal(grid) == (
        "file: tier 'phones', phoneme 3 at 0.200 s: 'AH' ends at 0.350 s, but 'L' begins at "
        "0.300 s; remove the overlap"
    )


def test_labels_without_length_are_dropped_with_their_count():
    rows = [*PHONES[:2], ("AA", 0.35, 0.35), *PHONES[2:]]
    labels = read(textgrid({"phones": rows}))

    assert told(textgrid({"phones": rows})) == rounded(PHONES)
    assert labels.notes == ("labels without length, left out: 1",)


def test_small_times_with_an_exponent_are_read():
    grid = GRID.replace("xmax = 0.1\n", "xmax = 1e-05\n").replace("xmin = 0.1\n", "xmin = 1e-05\n")

    assert told(grid)[0] == ("HH", 0.0, 200.0)


IN_MS = [(label, 1e3 * start_s, 1e3 * end_s) for label, start_s, end_s in PHONES]


@pytest.mark.parametrize(
    "content",
    [
        textgrid({"phones": IN_MS}, 2000.0),
        json.dumps({"phones": IN_MS}),
        "".join(f"{s}\t{e}\t{label}\n" for label, s, e in IN_MS),
        "".join(f"a 1 {s} {e - s} {label}\n" for label, s, e in IN_MS),
        json.dumps([{"word": "hello", "start": 100.0, "end": 650.0}]),
    ],
)
def test_milliseconds_are_refused_with_both_durations(content):
    error = refusal(content)

    assert "but the sound is 2.000 s long; give the labels of this sound, with times in" in error
    assert "ends at 1600.000 s" in error or "ends at 100.000 s" in error


def test_milliseconds_in_place_of_100_ns_leave_nothing():
    rows = "".join(f"{round(s)} {round(e)} {label}\n" for label, s, e in IN_MS)

    assert "all labels are silence, or times are not in seconds" in refusal(rows)


@pytest.mark.parametrize("n", range(40, len(GRID), 97))
def test_a_textgrid_that_is_cut_off_anywhere_is_refused(n):
    """All of it but the end of the last line, the silence after the speech."""
    if GRID[:n].count("intervals [") < GRID.count("intervals ["):
        refusal(GRID[:n])


@pytest.mark.parametrize("name", [each for each in OF_PHONES if each not in ("HTK",)])
def test_half_a_file_is_refused_or_told(name):
    text = OF_PHONES[name][1]
    half = text[: text.rfind("\n", 0, len(text) // 2) + 1] or text[: len(text) // 2]
    try:
        notes = read(half).notes
    except LabelError:
        return
    assert any("the sound is 2.000 s long; is the file cut off" in note for note in notes)


WRONG_CSV = CSV.replace("0.1,0.2,HH", "0.1,soon,HH")


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (LABEL_TRACK.replace("\t0.350000", "\tsoon", 1), "line 2: '0.200000\\tsoon\\tah' lacks"),
        ("-0.5\t0.2\tHH\n", "line 1: -0.5 to 0.2 s cannot be"),
        (WRONG_CSV, "line 4: '0.1,soon,HH,phones,mary' lacks columns of the lines before"),
        (CSV.replace("0.1,0.2,HH,phones,mary", "0.1"), "line 4: '0.1' lacks columns of the lines"),
        (GRID.replace("xmin = 0.1\n", "xmin = -0.1\n"), "time -0.1 s is before the sound begins"),
        (b"\xff\xfe\x00", "neither a TextGrid nor UTF-8 text"),
        (b"RIFF\xff\xff", "neither a TextGrid nor UTF-8 text"),
        ('{"facsNames": ["jawOpen"], "weightMat": [[0.1]]}', "as Audio2Face exports them), not"),
        ('{"tiers": {"phones": 3}}', "not a readable Praat TextGrid"),
        ('{"accent_phrases": [{"moras": [3]}]}', "all labels are silence"),
        ('{"mouthCues": [3]}', "no times of words"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(content, complaint):
    assert complaint in refusal(content)


def test_an_alphabet_that_is_named_decides():
    rows = json.dumps({"phones": [["hh", 0.0, 0.1], ["V", 0.1, 0.2]]})

    assert told(rows, alphabet="x-sampa", sound_s=None)[-1][0] == "AH"
    assert told(rows, sound_s=None)[-1][0] == "V"
    assert "alphabet 'klingon' is not known" in refusal(rows, alphabet="klingon")


def test_what_is_no_file_is_not_waited_for_and_told_in_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe")

    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path, Path("x" * 100_000)):
        with pytest.raises(LabelError, match="cannot be read") as raised:
            read_labels(LabelFile(path))
        assert len(str(raised.value)) < 400
    with pytest.raises(LabelError, match="no such file"):
        read_labels(LabelFile(tmp_path / "absent"))
