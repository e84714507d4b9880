import pytest
from lipservo_lab.bench.hearing.recognizer_bench import SpeakerGroupError, speaker_groups


def test_groups_come_from_the_corpus_or_from_a_table_of_ones_own(tmp_path):
    (tmp_path / "speakers.csv").write_text("speaker,group,gender\n7,child,f\n")
    (tmp_path / "mine.csv").write_text("speaker,kind\n7,whispers\n")
    assert speaker_groups("group", tmp_path, None)("7") == ("child", "f", "child f")
    assert speaker_groups("group", tmp_path, tmp_path / "mine.csv")("7") == ("whispers",)
    assert speaker_groups("group", tmp_path, None)("8") == ("unknown",)
    assert speaker_groups("speaker", tmp_path, None)("8") == ("8",)
    assert speaker_groups(None, tmp_path, None)("7") == ()


def test_no_table_and_a_table_for_nothing_are_refused(tmp_path):
    with pytest.raises(SpeakerGroupError, match="no such file; --by group needs a table"):
        speaker_groups("group", tmp_path, None)
    with pytest.raises(SpeakerGroupError, match="is for --by group"):
        speaker_groups("speaker", tmp_path, tmp_path / "speakers.csv")
