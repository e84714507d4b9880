"""Who sees what: balanced, blind, and the same for the same seed."""

import json
from collections import Counter
from dataclasses import asdict
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.study.rehearsal import trial_study
from lipservo_lab.study.sheets import (
    KEY_FILE,
    STUDY_FILE,
    Sentence,
    Size,
    StudyError,
    make_study,
    read_key,
    read_study,
    williams,
    write_study,
)
from small_study import METHODS

SIZE = Size(ratings=8, pairs=6, readings=4, sentences=4, checks=2, sheets=12)


@pytest.fixture(scope="module")
def dealt():
    return trial_study(METHODS, SIZE)


def shown(study, key, kind, raters):
    """(rater, clip, ...) of the items of a kind."""
    return [
        (rater, *(key.clips[name] for name in item.clips))
        for rater in raters
        for item in study.sheets[rater]
        if item.kind == kind
    ]


def test_over_as_many_raters_as_methods_each_is_seen_as_often_with_each_sentence(dealt):
    study, key = dealt
    ratings = shown(study, key, "rating", range(4))

    assert set(Counter((c.method, c.sentence) for _, c in ratings).values()) == {2}
    assert len({(c.method, c.sentence) for _, c in ratings}) == 16


def test_a_rater_sees_no_clip_twice_and_reads_no_sentence_that_is_heard(dealt):
    study, key = dealt
    for rater in range(12):
        seen = [(c.method, c.sentence) for _, c in shown(study, key, "rating", [rater])]
        heard = {c.sentence for kind in ("rating", "pair") for _, *clips in
                 shown(study, key, kind, [rater]) for c in clips}  # fmt: skip
        read = {c.sentence for _, c in shown(study, key, "reading", [rater])}

        assert len(seen) == len(set(seen)) == 8
        assert heard & read == set()


@given(st.integers(2, 12))
def test_each_method_follows_each_other_as_often_and_stands_as_often_at_each_place(n):
    rows = williams(n)
    follows = Counter(pair for row in rows.tolist() for pair in pairwise(row))

    assert len(set(follows.values())) == 1
    assert len(follows) == n * (n - 1)
    assert all(sorted(set(column)) == list(range(n)) for column in rows.T.tolist())
    assert len({len(rows) // n, *(Counter(column)[0] for column in rows.T.tolist())}) == 1


def test_every_pair_is_shown_both_ways_round_and_is_of_one_sentence(dealt):
    study, key = dealt
    pairs = shown(study, key, "pair", range(12))
    ways = Counter((a.method, b.method) for _, a, b in pairs)

    assert set(ways.values()) == {6}
    assert len(ways) == 12
    assert all(a.sentence == b.sentence for _, a, b in pairs)


def test_reading_comes_before_any_sound_and_checks_stand_among_the_rest(dealt):
    kinds = [item.kind for item in dealt[0].sheets[0]]

    assert kinds[:5] == ["reading"] * 4 + ["sound"]
    assert kinds[5:].count("check") == 2


def test_what_raters_get_names_no_method_and_no_sentence(dealt, tmp_path):
    study, key = dealt
    write_study(tmp_path, study, key)
    served = (tmp_path / STUDY_FILE).read_text()

    assert not any(f'"{word}"' in served for word in (*METHODS, "s0", "s7", key.seed))
    assert read_study(tmp_path) == study
    assert read_key(tmp_path) == key


def test_the_same_seed_deals_the_same_and_another_names_clips_anew(dealt):
    other = trial_study(METHODS, SIZE, seed=1)

    assert trial_study(METHODS, SIZE) == dealt
    assert set(other[0].duration_s) & set(dealt[0].duration_s) == set()


@pytest.mark.parametrize(
    ("methods", "size", "words"),
    [
        (METHODS[:1], SIZE, "two methods"),
        (METHODS, Size(ratings=20, sentences=4), "more --sentences"),
        (METHODS, Size(ratings=0, pairs=2, sentences=0), "more --sentences"),
        (METHODS, Size(ratings=4, sentences=40), "are needed"),
    ],
)
def test_a_study_that_cannot_be_dealt_says_what_to_change(methods, size, words):
    sentences = [Sentence(f"s{n}", ("a", "b"), 1.0) for n in range(8)]

    with pytest.raises(StudyError, match=words) as raised:
        make_study(methods, sentences, size, "seed")
    assert "\n" not in str(raised.value)


def test_a_damaged_file_of_a_study_is_named_with_what_is_wrong(dealt, tmp_path):
    write_study(tmp_path, *dealt)
    (tmp_path / KEY_FILE).write_text(json.dumps({**asdict(dealt[1]), "methods": 3}))

    with pytest.raises(StudyError, match=r"key\.json: methods: .*make the study anew"):
        read_key(tmp_path)
    with pytest.raises(StudyError, match="lipservo study make"):
        read_study(tmp_path / "nowhere")
