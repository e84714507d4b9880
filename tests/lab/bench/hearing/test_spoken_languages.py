"""Languages as espeak-ng speaks them; what a recogniser that knows the times hears of them."""

import json

import pytest
from lipservo_lab.bench.hearing.spoken_languages import (
    language_scores,
    language_sentences,
    read_languages,
)
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.errors import UserError
from lipsync.recognition.energy_recognizer import EnergyRecognizer


def test_there_are_ten_sentences_of_each_of_six_languages():
    sentences = language_sentences()
    assert set(sentences) == {"de", "fr", "es", "zh", "ja", "pt"}
    assert all(len(set(said)) == 10 for said in sentences.values())


def test_languages_are_chosen_by_tag_and_a_strange_one_is_named():
    assert read_languages("fr, ja") == ("fr", "ja")
    assert read_languages("") == tuple(language_sentences())
    with pytest.raises(UserError, match="--languages xx: there are no sentences in it; use de, fr"):
        read_languages("fr,xx")


def test_the_level_alone_hears_openings_and_no_closure(tmp_path):
    spoken = []
    scores = language_scores(["zh"], EnergyRecognizer, tmp_path, lambda: spoken.append(1))
    figures = scores["zh"].figures()
    assert len(spoken) == 10
    assert scores["zh"].bilabials.n_spoken > 15
    assert figures["closure_recall"] == 0.0
    assert figures["opening_recall"] > 0.5


@pytest.mark.slow
def test_the_command_prints_the_figures_of_the_languages_asked_for():
    done = CliRunner().invoke(app, ["bench", "languages", "--languages", "es", "--json", "-q"])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)["languages"]
    assert list(figures) == ["es"]
    assert figures["es"]["opening_recall"] > 0.6
    assert 0.3 < figures["es"]["viseme_speech"] < 1.0
