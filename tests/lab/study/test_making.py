"""A study from a corpus to its report, its films replaced by what was to be filmed."""

import json

import numpy as np
import pytest
from lipservo_lab.commands.groups import study as commands
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.evaluation.motion.methods import Heard
from lipservo_lab.learning.motion.face_training import train
from lipservo_lab.learning.motion.trained_model import save_model
from lipservo_lab.study.answers import AnswerFile
from lipservo_lab.study.making import (
    Material,
    Plan,
    held_out,
    planned_study,
    write_made_study,
)
from lipservo_lab.study.sheets import CLIPS, MACHINES_FILE, Size, StudyError, read_key, read_study
from lipservo_lab.study.shown_methods import (
    METHODS,
    RhubarbMethod,
    chosen_methods,
    faces_of_methods,
    vocabulary_of,
)
from lipservo_lab.study.study_figures import PEOPLE
from small_corpus import write_corpus
from small_model import small_model
from small_study import write_small_study
from typer.testing import CliRunner

from lipsync.errors import UserError
from lipsync.output_file import OutputError
from lipsync.phonemes import PhonemeEvent
from lipsync.textgrid import read_tiers, write_tiers

FIRST, SECOND = ("bee", "ah", "tea", "ooh"), ("one", "two")
NAMES = ("recorded", "rhubarb", "still")
SIZE = Size(ratings=3, pairs=3, readings=3, sentences=3, checks=1, sheets=6)
TEST = frozenset(f"s{n}" for n in range(8))


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    path = write_corpus(tmp_path_factory.mktemp("making") / "c", 16)
    for number in range(16):
        label = path / "labels" / f"s{number}.TextGrid"
        words = ((FIRST[number % 4], 0.4, 0.7), (SECOND[number % 2], 0.7, 1.0))
        write_tiers(label, {**read_tiers(label), "words": words})
    splits = {"folds": [], "random_test": sorted(TEST), "new_words": {}}
    (path / "splits.json").write_text(json.dumps(splits))
    return path


@pytest.fixture(scope="module")
def material(corpus):
    recordings = read_grid(corpus).labelled()
    learned = recordings.keep({u.name for u in recordings.utterances} - TEST)
    model = train(learned)
    return Material(
        model, held_out(recordings, TEST, "7"), learned.utterances, faces_of_methods(model, learned)
    )


def plan(size=SIZE):
    return Plan(NAMES, size, "7", "Faces", "Please")


def film(faces, rate_hz, sound, out):
    assert rate_hz == 25.0
    assert sound.exists()
    out.write_bytes(np.asarray(faces, dtype=np.float32).tobytes())


@pytest.fixture(scope="module")
def made(material, tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "study"
    study, key = planned_study(plan(), material.read, material.learned)
    write_made_study(folder, study, key, material, film, lambda _done, _of: None)
    return folder


def test_each_clip_is_the_motion_of_its_method_with_the_sound_of_its_sentence(made, material):
    key = read_key(made)
    by_name = {u.name: u for u in material.read}
    for name, clip in key.clips.items():
        utterance = by_name[clip.sentence]
        faces = np.frombuffer((made / CLIPS / f"{name}.mp4").read_bytes(), dtype=np.float32)
        faces = faces.reshape(len(utterance.markers_mm), -1)
        if clip.method == "recorded":
            assert np.allclose(faces, material.model.coefficients(utterance.markers_mm), atol=1e-4)
        if clip.method == "still":
            assert np.allclose(faces, material.model.rest, atol=1e-4)
    assert len(key.clips) == 3 * 6
    assert {clip.sentence for clip in key.clips.values()} < TEST


def test_the_lip_readers_read_every_clip_without_sound(made):
    records = [json.loads(line) for line in (made / MACHINES_FILE).read_text().splitlines()]
    read = {i.clips[0] for sheet in read_study(made).sheets for i in sheet if i.kind == "reading"}

    assert {r["reader"] for r in records} == {"components", "lips"}
    assert all({r["clip"] for r in records if r["reader"] == name} == read
               for name in ("components", "lips"))  # fmt: skip
    assert all(len(r["answer"].split()) == 2 for r in records)


def run(*arguments):
    done = CliRunner().invoke(commands, [str(each) for each in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.stdout


def test_simulated_raters_sit_it_and_the_report_finds_them_again(made, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra plots)")
    answers, page = tmp_path / "trial.jsonl", tmp_path / "report.html"
    run("rehearse", made, "-o", answers, "--raters", "12")
    report = ("report", made, "--answers", answers, "-o", page, "--no-mixed", "--json", "-q")
    figures = json.loads(run(*report))
    html = page.read_text()

    assert figures["raters"]["began"] == 16
    assert [row["method"] for row in figures["ratings"]] == list(NAMES)
    assert figures["ratings"][0]["mean"] > figures["ratings"][2]["mean"]
    assert set(figures["reading"]) == {PEOPLE, "reader of components", "reader of lips"}
    assert figures["reading"][PEOPLE][0]["words_right"] > figures["reading"][PEOPLE][2]["chance"]
    assert html.count("<svg") == 3
    assert "A rehearsal" in html
    assert "src=" not in html
    assert "Rhubarb&#x27;s rules" in html


def test_a_rehearsal_writes_over_another_one_and_never_over_answers_of_people(made, tmp_path):
    trial, answers = tmp_path / "trial.jsonl", tmp_path / "answers.jsonl"
    with AnswerFile(answers, read_study(made).identity) as file:
        file.join("anna", 1)
    before = answers.read_bytes()

    run("rehearse", made, "-o", trial, "--raters", 2)
    run("rehearse", made, "-o", trial, "--raters", 2)
    with pytest.raises(OutputError):
        run("rehearse", made, "-o", answers)
    assert answers.read_bytes() == before


def test_a_report_of_nobody_is_a_page_that_says_so(made, tmp_path):
    answers, page = tmp_path / "answers.jsonl", tmp_path / "report.html"
    answers.write_text(json.dumps({"kind": "study", "study": read_study(made).identity}) + "\n")
    run("report", made, "--answers", answers, "-o", page, "--no-mixed", "-q")

    assert "0 began, 0 are counted" in page.read_text()


def test_a_film_that_fails_leaves_no_folder(material, tmp_path):
    def full(*_):
        raise OSError(28, "No space left on device")

    study, key = planned_study(plan(), material.read, material.learned)
    with pytest.raises(OutputError, match="No space left on device"):
        write_made_study(tmp_path / "s", study, key, material, full, lambda *_: None)
    assert list(tmp_path.iterdir()) == []


def test_too_few_held_out_sentences_are_said_before_anything_is_filmed(material):
    with pytest.raises(StudyError, match="8 sentences are held out, 12 are needed: 9 to rate"):
        planned_study(
            plan(Size(ratings=9, readings=3, sentences=9)), material.read, material.learned
        )


def test_a_model_that_has_learned_what_is_shown_is_refused(corpus, tmp_path):
    pytest.importorskip("av", reason="PyAV is not installed (extra film)")
    save_model(train(read_grid(corpus).labelled()), tmp_path / "m.npz")
    with pytest.raises(StudyError, match=r"m\.npz: was trained on 8 of the sentences"):
        run(
            "make", tmp_path / "s", "--corpus", corpus, "--model", tmp_path / "m.npz", "-q",
            "--methods", "recorded,still", "--ratings", 2, "--sentences", 2, "--readings", 2,
        )  # fmt: skip
    assert not (tmp_path / "s").exists()


def test_methods_are_taken_by_their_names():
    assert chosen_methods("still, recorded,still") == ("still", "recorded")
    assert chosen_methods(",".join(METHODS)) == tuple(METHODS)
    with pytest.raises(StudyError, match="--methods catmull: use one of recorded, ears"):
        chosen_methods("still,catmull")


def test_rhubarbs_mouth_is_closed_in_a_b_and_open_after_it():
    model = small_model()
    phones = (
        PhonemeEvent("SIL", 0.0, 0.3), PhonemeEvent("B", 0.3, 0.4), PhonemeEvent("AA", 0.4, 0.8),
        PhonemeEvent("SIL", 0.8, 1.4),
    )  # fmt: skip
    times_s = np.arange(0.0, 1.4, 0.01)
    faces = RhubarbMethod().faces(model, Heard(phones), times_s, 0.0)
    gap_mm = model.lip_gaps_mm(model.markers_mm(faces))

    assert gap_mm[35] < gap_mm[60]
    assert np.allclose(faces[135], model.rest)
    assert np.abs(np.diff(faces, axis=0)).max() < np.ptp(faces, axis=0).max()


def test_words_are_offered_by_place_where_all_sentences_have_as_many():
    assert vocabulary_of([("bin", "blue"), ("lay", "blue")]) == (("bin", "lay"), ("blue",))
    assert vocabulary_of([("bin", "blue"), ("lay",)]) == ()


def test_clips_that_are_gone_or_empty_are_said_before_a_rater_comes(tmp_path):
    study, _ = write_small_study(tmp_path, films=False)
    first, second, *_ = sorted(study.duration_s)
    (tmp_path / CLIPS / f"{first}.mp4").unlink()
    (tmp_path / CLIPS / f"{second}.mp4").write_bytes(b"")
    with pytest.raises(UserError, match=f"2 of .* clips are missing .({first}|{second}).mp4"):
        run("serve", tmp_path)
    assert not (tmp_path / "answers.jsonl").exists()
