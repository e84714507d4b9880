import math

import pytest
from speech import CLIP_LABELS_PATH

from lipsync.phoneme_files.reader import read_phonemes
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate
from lipsync.recognition.scripted import ScriptedPhonemes
from lipsync.textgrid import LabelError, read_tiers
from lipsync.timeline import PhonemeTimeline

MAP = (PhonemeEvent("M", 0.1, 0.2), PhonemeEvent("AE", 0.2, 0.35), PhonemeEvent("P", 0.35, 0.4))

TEXTGRID = """File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 1
tiers? <exists>
size = 2
item []:
    item [1]:
        class = "IntervalTier"
        name = "phones"
        xmin = 0
        xmax = 1
        intervals: size = 2
        intervals [1]:
            xmin = 0
            xmax = 0.4
            text = ""
        intervals [2]:
            xmin = 0.4
            xmax = 1
            text = "AA"
    item [2]:
        class = "TextTier"
        name = "clicks"
        xmin = 0
        xmax = 1
        points: size = 1
        points [1]:
            number = 0.5
            mark = "x"
"""


def test_an_event_is_told_with_its_start_once_heard_and_its_end_once_over():
    source = ScriptedPhonemes(MAP)

    assert source.updates(0.1) == [PhonemeUpdate(0.0, 0.1, 0.1, ())]
    assert source.updates(0.15) == [PhonemeUpdate(0.1, 0.15, 0.15, (PhonemeEvent("M", 0.1, None),))]
    assert source.updates(0.2) == [PhonemeUpdate(0.15, 0.2, 0.2, (MAP[0],))]
    assert source.updates(0.38) == [
        PhonemeUpdate(0.2, 0.38, 0.38, (MAP[1], PhonemeEvent("P", 0.35, None)))
    ]
    assert source.updates(0.38) == []


def test_lookahead_lets_it_see_that_much_into_the_future():
    source = ScriptedPhonemes(MAP, lookahead_s=0.25)

    assert source.updates(0.0) == [
        PhonemeUpdate(0.0, 0.0, 0.25, (MAP[0], PhonemeEvent("AE", 0.2, None)))
    ]


@pytest.mark.parametrize("step_s", [0.001, 0.01, 0.07, 10.0])
def test_a_timeline_fed_in_any_steps_ends_with_the_script(step_s):
    events = read_phonemes(CLIP_LABELS_PATH)
    source, timeline = ScriptedPhonemes(events), PhonemeTimeline(horizon_s=math.inf)

    for n in range(1, math.ceil(8.7 / step_s) + 1):
        for update in source.updates(n * step_s):
            timeline.apply(update)

    assert timeline.events == events


@pytest.mark.parametrize(
    "events",
    [
        (MAP[1], MAP[0]),
        (MAP[0], PhonemeEvent("AE", 0.19, 0.3)),
        (PhonemeEvent("M", 0.1, None), MAP[1]),
    ],
)
def test_a_script_out_of_order_is_refused(events):
    with pytest.raises(ValueError, match="must end before"):
        ScriptedPhonemes(events)


def test_stretches_without_a_label_are_silence(tmp_path):
    (tmp_path / "a.TextGrid").write_text(TEXTGRID)

    assert read_phonemes(tmp_path / "a.TextGrid") == (
        PhonemeEvent("SIL", 0.0, 0.4),
        PhonemeEvent("AA", 0.4, 1.0),
    )
    assert read_tiers(tmp_path / "a.TextGrid")["phones"][0] == ("", 0.0, 0.4)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            TEXTGRID.replace('"AA"', '"AA9"'),
            "phoneme 2 at 0.400 s: 'AA9' is neither ARPAbet nor IPA",
        ),
        (TEXTGRID.replace('"phones"', '"words"'), "has words but no phonemes"),
        (TEXTGRID.replace("xmin = 0.4", "xmin = 2"), "'AA': '2' to '1' s cannot be"),
        (TEXTGRID[:300], "not a readable Praat TextGrid"),
        ("", "empty; docs/text.md"),
        ("phones: AA", "line 1 is neither labels nor JSON; docs/text.md"),
    ],
)
def test_a_bad_label_file_is_refused_in_one_line_that_names_it(tmp_path, text, complaint):
    path = tmp_path / "bad.TextGrid"
    path.write_text(text)

    with pytest.raises(LabelError) as refusal:
        read_phonemes(path)

    assert str(refusal.value).startswith(f"{path}: ")
    assert complaint in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_missing_label_file_is_refused(tmp_path):
    with pytest.raises(LabelError, match="no such file"):
        read_phonemes(tmp_path / "nowhere.TextGrid")
