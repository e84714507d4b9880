"""`bench recognition --by`, on the bundled clip as a corpus of one speaker."""

import json
import shutil

import pytest
from speech import CLIP_LABELS_PATH, CLIP_PATH
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.textgrid import read_tiers, write_tiers


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corpus") / "reader"
    (folder / "labels").mkdir(parents=True)
    (folder / "audio").mkdir()
    shutil.copy(CLIP_PATH, folder / "audio" / f"welcome{CLIP_PATH.suffix}")
    tiers = read_tiers(CLIP_LABELS_PATH)
    phones = tiers.get("phones") or next(iter(tiers.values()))
    words = (("hello", phones[0][1], phones[-1][2]),)
    write_tiers(folder / "labels" / "welcome.TextGrid", {"words": words, "phones": phones})
    return folder


def bench(corpus, *options):
    return CliRunner().invoke(
        app, ["bench", "recognition", "--corpus", str(corpus), "--json", "-q", *options]
    )


def test_a_corpus_of_one_speaker_has_that_speakers_figures(corpus):
    done = bench(corpus, "--by", "speaker")
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    (group,) = figures["groups"].values()
    assert set(figures["groups"]) == {"reader"}
    for key, value in group.items():
        if key not in ("closures", "utterances"):
            assert figures[key] == value
    assert group["utterances"] == 1
    assert group["closures"] > 5
    assert group["closure_recall"] > 0.5
    assert abs(group["closure_onset_error_ms_p50"]) <= 40.0
    assert 0.0 <= group["labiodental_precision"] <= 1.0


@pytest.mark.slow
def test_without_by_there_are_no_groups_and_with_a_table_the_tables(corpus, tmp_path):
    table = tmp_path / "speakers.csv"
    table.write_text("speaker,group,gender\nreader,adult,f\n")
    done = bench(corpus, "--by", "group", "--groups", str(table))
    assert set(json.loads(done.stdout)["groups"]) == {"adult", "f", "adult f"}
    assert "groups" not in json.loads(bench(corpus).stdout)
