"""`learn adapt`, as it is typed: weights that hear a voice better, or one line and no file."""

import json
import shutil
from importlib import resources

import numpy as np
import pytest
import soundfile
from lipservo_lab.learning.recognition.noise import chords
from small_network import random_weights
from speech import CLIP_LABELS_PATH, CLIP_PATH
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.recognition.network import adapted_from, find_weights, save_weights
from lipsync.textgrid import read_tiers, write_tiers

pytest.importorskip("torch", reason="the extra `train` is not installed")

#: So often 8.6 s are more than two minutes.
N_SENTENCES = 15


def write_labelled(folder, phones, name, text):
    for part in ("audio", "labels"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    shutil.copy(CLIP_PATH, folder / "audio" / f"{name}.flac")
    tiers = {"words": ((text, 0.0, 8.6),), "phones": phones}
    write_tiers(folder / "labels" / f"{name}.TextGrid", tiers)


@pytest.fixture(scope="module")
def voice(tmp_path_factory):
    """The bundled clip as often as makes two minutes, with its phones, each a sentence."""
    folder = tmp_path_factory.mktemp("adapt") / "voice"
    for number in range(N_SENTENCES):
        write_labelled(folder, read_tiers(CLIP_LABELS_PATH)["phones"], f"s{number}", f"no {number}")
    return folder


@pytest.fixture
def adapt(tmp_path):
    """The command with a small network to start from: what came of it, and the file to write."""
    small, written = tmp_path / "small.npz", tmp_path / "my.npz"
    save_weights(random_weights(n_channels=8, dilations=(1, 2)), small)

    def run(folder, *options, output=written):
        given = ("--weights", str(small), "--copies", "0", "--jobs", "1", "-q", *options)
        return CliRunner().invoke(
            app, ["learn", "adapt", str(folder), "-o", str(output), *given]
        ), written

    return run


def told(done, written):
    """The one line of a refusal that leaves no file."""
    assert done.exit_code == 1
    assert "\n" not in str(done.exception)
    assert not list(written.parent.glob("my.npz*"))
    return str(done.exception)


def test_weights_that_hear_the_voice_better_are_written_and_can_be_used(adapt, voice):
    done, written = adapt(voice, "--steps", "40", "--rate", "0.01", "--json")

    assert done.exit_code == 0, done.exception
    printed = json.loads(done.stdout)
    assert printed["better"]
    assert printed["after"]["viseme_speech"] > printed["before"]["viseme_speech"]
    assert (printed["sentences"], printed["held_out_sentences"]) == (12, 3)
    assert printed["left_out"] == {}
    find_weights(str(written))
    with np.load(written) as file:
        provenance = json.loads(str(file["provenance"]))
    assert (provenance["voice"], provenance["steps"]) == ("voice", 40)
    assert adapted_from(str(written)) == provenance["adapted_from"]
    heard = CliRunner().invoke(
        app, ["lines", "recognize", str(CLIP_PATH), "--weights", str(written), "--json"]
    )
    assert heard.exit_code == 0


def test_weights_that_are_not_better_are_refused(adapt, voice):
    done, written = adapt(voice, "--steps", "1", "--rate", "0")

    assert "do not recognise this voice better than" in told(done, written)
    assert "P B M heard" in done.stdout


def test_a_label_outside_the_inventory_is_named_with_its_file(adapt, voice, tmp_path):
    folder = tmp_path / "voice"
    shutil.copytree(voice, folder)
    write_labelled(folder, (("QQ", 1.25, 2.0),), "s7", "no 7")

    line = told(*adapt(folder))
    assert "at 1.250 s: 'QQ' is neither ARPAbet nor IPA" in line


def test_a_file_that_is_no_sound_is_named(adapt, voice, tmp_path):
    folder = tmp_path / "voice"
    shutil.copytree(voice, folder)
    (folder / "audio" / "s3.flac").write_bytes(b"no sound at all")

    assert "s3.flac" in told(*adapt(folder))


def test_without_torch_the_extra_is_named(adapt, voice, monkeypatch):
    monkeypatch.setattr("lipsync.errors.find_spec", lambda _library: None)

    line = told(*adapt(voice))
    assert "adapt needs torch" in line
    assert "lipservo-lab[train]" in line


#: What the aligner's dictionary holds: sentences for sounds in which something else is heard.
OTHER_TEXTS = (
    "the boat was lying at the pier",
    "please put the paper beside the lamp",
    "my brother built a bigger bridge",
    "five people were waiting for the train",
    "she sells the best bread in the village",
)


@pytest.mark.slow
@pytest.mark.parametrize("sound", ["speech", "music"])
def test_texts_that_nobody_says_are_refused(adapt, tmp_path, sound):
    speech, rate_hz = soundfile.read(
        str(resources.files("lipservo.clips") / "welcome.flac"), dtype="float32"
    )
    for number in range(N_SENTENCES):
        music = chords(np.random.default_rng(number), 9 * rate_hz) * np.float32(0.1)
        soundfile.write(tmp_path / f"{number}.wav", speech if sound == "speech" else music, rate_hz)
        text = f"{OTHER_TEXTS[number % 5]} {OTHER_TEXTS[(number // 5 + 1) % 5]}"
        (tmp_path / f"{number}.txt").write_text(text)

    line = told(*adapt(tmp_path))
    assert "the text is not what is said in" in line
    assert "check that each text belongs to its sound" in line
