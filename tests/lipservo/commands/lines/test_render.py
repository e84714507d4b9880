"""`train-offline` and `render`, from the command line, on a made-up corpus."""

import json
import shutil

import numpy as np
import pytest
import soundfile
from small_corpus import write_corpus
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.rendering import rendered
from lipservo.runtime.speech.performed_line import performed_line
from lipsync.face.model import load_face
from lipsync.offline.offline_model_file import load_offline_model
from lipsync.offline.performance import read_performance, sound_file


def invoke(*arguments):
    return CliRunner().invoke(app, [str(each) for each in arguments])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A corpus, the face model of it, and the offline model of both."""
    folder = tmp_path_factory.mktemp("lines")
    corpus, face, offline = folder / "corpus", folder / "face.npz", folder / "offline.npz"
    write_corpus(corpus, 12)
    trained = invoke(
        "learn", "face", corpus, "-o", face, "--phonemes", "true", "--components", 4, "-q"
    )
    assert trained.exit_code == 0, trained.output
    done = invoke(
        "learn", "offline", corpus, "-o", offline, "--model", face,
        "--states", 20, "--components", 4, "--json", "-q",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    return corpus, face, offline, json.loads(done.stdout)


def of(made):
    _, face, offline, _ = made
    return ["--model", face, "--offline", offline]


def one(made, number=0):
    corpus = made[0]
    return corpus / "audio" / f"s{number}.flac", corpus / "labels" / f"s{number}.TextGrid"


def folder_of(made, folder, n_lines):
    """A folder of the first lines, each with its labels."""
    folder.mkdir()
    for path in (path for number in range(n_lines) for path in one(made, number)):
        shutil.copy(path, folder / path.name)
    return folder


def test_what_was_learned_is_told_and_read_back(made):
    _, face, offline, figures = made
    model = load_offline_model(offline)

    assert figures["states"] == model.states.n_states == 20
    assert figures["units"] == len(model.states.units.phonemes) == 12 * 6
    assert figures["face"] == model.face_checksum == load_face(face).checksum
    assert len(model.states.cepstra) == 12 * 30


def test_the_same_corpus_gives_the_same_file(made, tmp_path):
    corpus, face, offline, _ = made
    again = tmp_path / "again.npz"
    invoke(
        "learn", "offline", corpus, "-o", again, "--model", face,
        "--states", 20, "--components", 4, "-q",
    )  # fmt: skip

    assert again.read_bytes() == offline.read_bytes()


def test_a_corpus_may_have_more_points_than_the_face_but_not_fewer(made, tmp_path):
    corpus, face, _, _ = made
    smaller, output = tmp_path / "face_39.npz", tmp_path / "offline.npz"
    recipe = ["--components", 4, "-q"]
    invoke("learn", "face", corpus, "-o", smaller, "--phonemes", "true", "--markers", 39, *recipe)
    recipe += ["--states", 20, "-o", output]

    fewer = invoke("learn", "offline", corpus, "--model", face, "--markers", 39, *recipe)
    assert fewer.exit_code != 0
    assert "points of the face model" in str(fewer.exception)
    assert not output.exists()

    dense = invoke(
        "learn", "offline", corpus, "--model", smaller, "--markers", 47, "--json", *recipe
    )
    assert dense.exit_code == 0, dense.output
    assert json.loads(dense.stdout)["points"] == 47
    assert len(load_offline_model(output).states.mean_mm) == 39 * 3


@pytest.mark.parametrize("method", ["heard", "model-based", "live"])
def test_a_line_becomes_a_performance(made, tmp_path, method):
    sound, labels = one(made)
    output = tmp_path / "line.perf"
    asked = ["--textgrid", labels, "-o", output, "--method", method, "--json"]
    done = invoke("lines", "render", sound, *asked, *of(made))
    said = json.loads(done.stdout)
    found = read_performance(output)

    assert done.exit_code == 0
    assert said["duration_s"] == pytest.approx(1.2)
    assert found.method == method
    assert found.coefficients.shape == (121, 4)
    with sound_file(found.sound, output) as kept:
        assert kept.read_bytes() == sound.read_bytes()
    assert found.phonemes[0].phoneme == "SIL"
    assert np.ptp(found.coefficients[:, 0]) > 1.0


def test_the_channel_that_was_rendered_is_the_one_that_is_played(made, tmp_path):
    sound, output = tmp_path / "line.wav", tmp_path / "line.perf"
    mono, rate_hz = soundfile.read(one(made)[0])
    soundfile.write(sound, np.stack([0.1 * mono, 0.5 * mono], axis=1), rate_hz)
    channel = ["--channel", "right", "--textgrid", one(made)[1]]
    assert invoke("lines", "render", sound, "-o", output, *channel, *of(made)).exit_code == 0

    played = np.concatenate(list(performed_line(read_performance(output), output).sounds()))
    assert played == pytest.approx(0.5 * mono, abs=1e-3)


@pytest.mark.slow
def test_a_folder_on_all_cores_is_the_same_as_one_by_one(made, tmp_path):
    lines = folder_of(made, tmp_path / "lines", 3)
    both = [tmp_path / "serial", tmp_path / "parallel"]
    for folder, jobs in zip(both, (1, 2), strict=True):
        asked = ["lines", "render-folder", lines, "-o", folder, "--jobs", jobs, "--json", "-q"]
        assert json.loads(invoke(*asked, *of(made)).stdout)["rendered"] == 3

    for number in range(3):
        name = f"s{number}.perf"
        assert (both[0] / name).read_bytes() == (both[1] / name).read_bytes()


@pytest.fixture
def folder(made, tmp_path):
    """Two lines, rendered; and how they are rendered again: what is told, and the files' times."""
    lines, output = folder_of(made, tmp_path / "lines", 2), tmp_path / "out"

    def again(*options):
        asked = ["lines", "render-folder", lines, "-o", output, "--jobs", 1, "--json", "-q"]
        done = invoke(*asked, *of(made), *options)
        assert done.exit_code == 0, done.exception
        said = json.loads(done.stdout)
        return said["rendered"], said["kept"]

    assert again() == (2, 0)
    return lines, output, again


def test_a_folder_that_is_rendered_is_not_rendered_again(folder):
    _, output, again = folder
    before = {path: path.stat().st_mtime_ns for path in output.iterdir()}

    assert again() == (0, 2)
    assert {path: path.stat().st_mtime_ns for path in output.iterdir()} == before


def test_a_line_of_another_sound_script_or_option_is_rendered_anew(folder):
    lines, _, again = folder
    soundfile.write(lines / "s0.flac", 0.5 * soundfile.read(lines / "s0.flac")[0], 16_000)
    assert again() == (1, 1)
    labels = lines / "s1.TextGrid"
    labels.write_text(labels.read_text().replace("AA", "IY"))
    assert again() == (1, 1)
    labels.unlink()
    assert again() == (1, 1)
    for options in (["--strength", 0.5], ["--reference-sound"], ["--expression", "face_head"]):
        assert again(*options) == (2, 0)
    assert again("--method", "live") == (2, 0)
    assert again("--method", "live") == (0, 2)


def test_a_line_of_another_model_or_version_is_rendered_anew(folder, made, tmp_path, monkeypatch):
    again = folder[2]
    same, other = tmp_path / "same.npz", tmp_path / "other.npz"
    shutil.copy(made[2], same)
    recipe = ["--model", made[1], "--states", 19, "--components", 4, "-q"]
    invoke("learn", "offline", made[0], "-o", other, *recipe)

    assert again("--offline", same) == (0, 2)  # its bytes count, not its name
    assert again("--offline", other) == (2, 0)
    monkeypatch.setattr("lipservo.rendering.rendered.version", lambda _name: "0.0.1")
    rendered._common_origin.cache_clear()
    assert again("--offline", other) == (2, 0)


def test_a_model_that_was_replaced_under_its_name_is_loaded_anew(folder, made, tmp_path):
    """As on Dask's workers, which live on while a model is learned again."""
    again, offline = folder[2], tmp_path / "offline.npz"
    shutil.copy(made[2], offline)
    assert again("--offline", offline) == (0, 2)
    recipe = ["--model", made[1], "--states", 19, "--components", 4, "-q"]
    invoke("learn", "offline", made[0], "-o", offline, *recipe)

    assert again("--offline", offline) == (2, 0)
    assert rendered.load_speaker(made[1], offline).offline.states.n_states == 19


def test_a_sound_that_is_replaced_while_it_is_rendered_is_refused(made, tmp_path, monkeypatch):
    sound, output = tmp_path / "line.flac", tmp_path / "line.perf"
    shutil.copy(one(made)[0], sound)
    faces_of = rendered.rendered_faces

    def replaced_meanwhile(*given):
        shutil.copy(one(made, 1)[0], sound)
        return faces_of(*given)

    monkeypatch.setattr(rendered, "rendered_faces", replaced_meanwhile)
    asked = ["--textgrid", one(made)[1], "-o", output, *of(made)]
    assert "changed while it was rendered" in refusal("lines", "render", sound, *asked)
    assert not output.exists()


@pytest.mark.parametrize("place", [0.3, 0.7])
def test_half_a_file_and_a_wrong_byte_are_never_taken_for_a_whole_one(folder, place):
    _, output, again = folder
    whole = (output / "s0.perf").read_bytes()
    at = round(place * len(whole))
    (output / "s0.perf").write_bytes(whole[:at])
    (output / "s1.perf.partial").write_bytes(whole[:at])  # what a killed run leaves
    assert again() == (1, 1)
    assert (output / "s0.perf").read_bytes() == whole
    wrong = bytearray(whole)
    wrong[at] ^= 0xFF
    (output / "s0.perf").write_bytes(wrong)
    assert again() == (1, 1)
    assert (output / "s0.perf").read_bytes() == whole


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # what Dask's event loops leave is not ours
def test_a_folder_on_a_cluster_of_two_workers_is_the_same_as_one_by_one(
    made, tmp_path, monkeypatch
):
    distributed = pytest.importorskip("distributed", reason="pip install 'lipservo-lab[cluster]'")
    lines = folder_of(made, tmp_path / "lines", 5)
    (lines / "broken.wav").write_bytes(b"no sound")
    monkeypatch.chdir(tmp_path)  # where no worker is
    asked = ["lines", "render-folder", "lines", "--json", "-q", "--expression", "face_head"]
    asked += of(made)
    invoke(*asked, "-o", "serial", "--jobs", 1)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address.removeprefix("tcp://")
        done = invoke(*asked, "-o", "dask", "--dask", address)

    assert "broken.wav" in str(done.exception)
    assert json.loads(done.stdout)["rendered"] == 5
    serial, dask = (sorted((tmp_path / name).iterdir()) for name in ("serial", "dask"))
    assert [path.name for path in dask] == [path.name for path in serial]
    for one_by_one, on_cluster in zip(serial, dask, strict=True):
        assert on_cluster.read_bytes() == one_by_one.read_bytes()


def test_head_and_eyes_are_stored_when_a_face_is_named(made, tmp_path):
    sound, labels = one(made)
    plain, whole = tmp_path / "plain.perf", tmp_path / "whole.perf"
    asked = ["lines", "render", sound, "--textgrid", labels, *of(made)]
    invoke(*asked, "-o", plain)
    invoke(*asked, "-o", whole, "--expression", "face_head")
    found = read_performance(whole)

    assert read_performance(plain).expression == {}
    assert {len(values) for values in found.expression.values()} == {121}
    np.testing.assert_array_equal(found.coefficients, read_performance(plain).coefficients)


def test_a_bad_line_is_told_and_leaves_the_others(made, tmp_path):
    lines = folder_of(made, tmp_path / "lines", 1)
    (lines / "broken.wav").write_bytes(b"no sound")
    asked = ["lines", "render-folder", lines, "-o", tmp_path / "out", "--jobs", 1, "--json", "-q"]
    done = invoke(*asked, *of(made))

    assert done.exit_code != 0
    assert "broken.wav" in str(done.exception)
    assert json.loads(done.stdout)["rendered"] == 1
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["s0.perf"]


def refusal(*arguments):
    done = invoke(*arguments)
    assert done.exit_code != 0
    text = str(done.exception)
    assert "\n" not in text
    return text


def test_mistakes_are_told_in_one_line_and_leave_no_file(made, tmp_path):
    sound, labels = one(made)
    output = tmp_path / "line.perf"
    long, silent, short = (tmp_path / f"{name}.wav" for name in ("long", "silent", "short"))
    soundfile.write(long, np.full(310 * 8_000, 0.1, np.float32), 8_000)
    soundfile.write(silent, np.zeros(16_000, np.float32), 16_000)
    soundfile.write(short, np.full(1600, 0.1, np.float32), 16_000)

    def refused(*asked):
        return refusal("lines", "render", "-o", output, *of(made), *asked)

    assert "at most 300 s" in refused(long)
    assert "no words" in refused(sound, "--text", " ")
    assert "silen" in refused(silent)
    assert "give --text or --textgrid" in refused(sound, "--text", "hello", "--textgrid", labels)
    assert "give the labels of this sound" in refused(short, "--textgrid", labels)
    assert refused(sound, "--text", "the quick brown fox jumps over it")
    of_shipped_face = ["lines", "render", "-o", output, sound, "--offline", made[2]]
    assert "made for face model" in refusal(*of_shipped_face, "--textgrid", labels)
    assert not output.exists()


def test_a_corpus_too_small_for_the_states_asked_is_refused(made, tmp_path):
    corpus, face, _, _ = made
    output = tmp_path / "offline.npz"

    text = refusal("learn", "offline", corpus, "-o", output, "--model", face, "--states", 300, "-q")

    assert "too few for 300 states" in text
    assert not output.exists()


def test_an_offline_model_of_another_kind_or_damaged_is_refused(made, tmp_path):
    sound, labels = one(made)
    face, offline = made[1], made[2]
    damaged = tmp_path / "damaged.npz"
    damaged.write_bytes(offline.read_bytes()[:-2000])
    for wrong in (face, damaged, labels, tmp_path / "none.npz"):
        text = refusal(
            "lines", "render", sound, "--textgrid", labels, "-o", tmp_path / "x.perf",
            "--model", face, "--offline", wrong,
        )  # fmt: skip
        assert str(wrong) in text
