import pytest
from lipservo_lab.corpus.transcribed import TranscriptError, read_speakers


def test_a_speaker_is_in_each_of_the_groups_and_in_both_together(tmp_path):
    table = tmp_path / "speakers.csv"
    table.write_text("speaker,group,gender\n0006,child,f\n0007,adult,m\n")
    assert read_speakers(table) == {
        "0006": ("child", "f", "child f"),
        "0007": ("adult", "m", "adult m"),
    }


def test_one_column_is_enough(tmp_path):
    table = tmp_path / "speakers.csv"
    table.write_text("speaker,gender\na,f\nb,\n")
    assert read_speakers(table) == {"a": ("f",), "b": ()}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no table of speakers"),
        ("name,sex\na,f\n", "no table of speakers"),
        ("speaker,sex\na,f\na,m\n", "line 3: speaker 'a'"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(tmp_path, text, told):
    table = tmp_path / "speakers.csv"
    table.write_text(text)
    with pytest.raises(TranscriptError, match=told):
        read_speakers(table)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(TranscriptError, match="cannot be read as a table of speakers"):
        read_speakers(tmp_path / "none.csv")
