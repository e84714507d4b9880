"""The clip's phonemes with wrong times, through the real recogniser: two rows of the table."""

from lipservo_lab.bench.sync import timed_units


def test_an_offset_is_mended_and_another_sentence_is_not_believed(monkeypatch):
    wanted = ("200 ms late", "of another sentence")
    defects = timed_units.defects

    def two(spoken):
        return {name: told for name, told in defects(spoken).items() if name in wanted}

    monkeypatch.setattr(timed_units, "defects", two)
    rows = {row["defect"]: row for row in timed_units.timed_figures(lambda *_: None)}
    late, other = (rows[name] for name in wanted)
    assert late["right"] >= 0.91
    assert other["right"] >= 0.70
    for row in rows.values():
        assert row["closures"] >= 14
        assert row["false_closures"] <= 1
