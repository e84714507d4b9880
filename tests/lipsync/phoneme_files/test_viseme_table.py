"""The phone that stands for each viseme."""

import pytest

from lipsync.phoneme_files.formats import viseme_rows
from lipsync.phonemes import PHONEMES


@pytest.mark.parametrize(("viseme_set", "n"), [("polly", 20), ("azure", 22), ("ovr", 18)])
def test_every_viseme_has_a_phone_and_a_reason(viseme_set, n):
    rows = viseme_rows(viseme_set)

    assert len(rows) == n
    assert {phone for phone, _ in rows.values()} <= set(PHONEMES)
    assert all(reason for _, reason in rows.values())


def test_closed_lips_are_closed_lips_in_every_set():
    closing = {viseme_rows("polly")["p"], viseme_rows("azure")["21"], viseme_rows("ovr")["PP"]}
    assert {phone for phone, _ in closing} == {"P"}
