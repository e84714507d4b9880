"""The file of answers: nothing that was confirmed is lost, whatever happens to it."""

import errno
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.study import answers as module
from lipservo_lab.study.answers import (
    AlreadyAnsweredError,
    AnswerFile,
    UnknownRaterError,
    parse_answers,
    read_answers,
)
from lipservo_lab.study.sheets import StudyError

STUDY = "0123456789abcdef"


def given_answer(answer):
    return {"answer": answer, "seconds": 3.5, "plays": 1}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "answers.jsonl"


def fill(path, n):
    with AnswerFile(path, STUDY) as file:
        file.join("anna", 4)
        for number in range(n):
            file.answer("anna", number, given_answer(number))


def test_what_was_answered_is_there_when_the_file_is_opened_again(path):
    fill(path, 3)
    with AnswerFile(path, STUDY) as file:
        assert file.rater("anna").answers.keys() == {0, 1, 2}
        assert file.join("anna", 4).sheet == 0
        assert file.join("bert", 4).sheet == 1


def test_an_answer_sent_twice_counts_once_and_another_one_is_refused(path):
    fill(path, 1)
    size = path.stat().st_size
    with AnswerFile(path, STUDY) as file:
        file.answer("anna", 0, given_answer(0))
        assert path.stat().st_size == size
        with pytest.raises(AlreadyAnsweredError):
            file.answer("anna", 0, given_answer(5))
        with pytest.raises(UnknownRaterError):
            file.answer("carl", 0, given_answer(1))


def test_a_second_server_of_one_study_is_refused_in_one_line(path):
    with AnswerFile(path, STUDY), pytest.raises(StudyError, match=r"another .* end it first"):
        AnswerFile(path, STUDY)
    AnswerFile(path, STUDY).__exit__()


@given(cut=st.integers(0, 400))
def test_a_file_cut_anywhere_keeps_every_whole_line_and_lays_the_rest_beside(cut, tmp_path_factory):
    path = tmp_path_factory.mktemp("cut") / "answers.jsonl"
    fill(path, 4)
    whole = path.read_bytes()
    cut = min(cut, len(whole))
    path.write_bytes(whole[:cut])
    lines = whole[:cut].count(b"\n")
    torn = whole[:cut].rpartition(b"\n")[2]

    with AnswerFile(path, STUDY) as file:
        assert file.n_torn == len(torn)
        found = file.raters["anna"].answers if "anna" in file.raters else {}
        assert len(found) == max(0, lines - 2)
        file.join("anna", 4)
        for number in range(4):
            file.answer("anna", number, given_answer(number))
    assert read_answers(path, STUDY).raters["anna"].answers.keys() == {0, 1, 2, 3}
    beside = path.with_name("answers.jsonl.torn")
    assert (beside.read_bytes() if torn else b"\n") == torn + b"\n"


def test_on_a_full_disk_nothing_is_half_written_and_it_goes_on_when_there_is_room(
    path, monkeypatch
):
    """As write(2) does: a part of the line goes in, then nothing does."""
    fill(path, 2)
    before = path.read_bytes()
    write = os.write
    with AnswerFile(path, STUDY) as file:
        monkeypatch.setattr(module.os, "write", lambda fd, line: write(fd, line[:7]))
        with pytest.raises(StudyError, match="was not stored: No space left on device"):
            file.answer("anna", 2, given_answer(2))
        assert path.read_bytes() == before

        monkeypatch.setattr(module.os, "write", write)
        monkeypatch.setattr(module.os, "fsync", _full)
        with pytest.raises(StudyError, match="was not stored"):
            file.answer("anna", 2, given_answer(2))
        assert path.read_bytes() == before

        monkeypatch.undo()
        file.answer("anna", 2, given_answer(2))
    assert len(read_answers(path, STUDY).raters["anna"].answers) == 3


def _full(_fd):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_line_that_is_damaged_in_the_middle_is_named(path):
    fill(path, 3)
    lines = path.read_bytes().split(b"\n")
    path.write_bytes(b"\n".join([*lines[:3], b"{damaged", *lines[3:]]))

    for read in (lambda: read_answers(path, STUDY), lambda: AnswerFile(path, STUDY)):
        with pytest.raises(StudyError, match=r"answers\.jsonl, line 4: is no record"):
            read()


def test_answers_of_another_study_are_not_taken_for_its_own(path):
    fill(path, 1)
    with pytest.raises(StudyError, match="holds answers of study 0123456789abcdef"):
        AnswerFile(path, "f" * 16)


def test_who_leaves_has_left_for_good(path):
    fill(path, 2)
    with AnswerFile(path, STUDY) as file:
        file.leave("anna")
        file.leave("anna")
    assert parse_answers(path, path.read_bytes(), STUDY).raters["anna"].has_left
    assert path.read_bytes().count(b'"leave"') == 1
