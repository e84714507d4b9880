"""A robot that speaks, from the command line: what it says, and what it refuses in one line."""

import json
import re
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import soundfile
from fake_sound_card import device, install_sound_card
from in_process import lipservo
from speech import CLIP_LABELS_PATH, CLIP_PATH
from voice_agents.served_face import ServedFace

from lipservo import connect
from lipservo.access.admission import Policy
from lipservo.agents.listener import AgentSettings
from lipsync.phoneme_files.reader import read_phonemes
from lipsync.text_to_speech.synthesis import SynthesisError
from lipsync.text_to_speech.synthesizers import synthesizer_for

pytestmark = pytest.mark.usefixtures("own_folder")
#: The clip's script, as far as it is said.
CUT_S = 1.0


@pytest.fixture
def _espeak():
    try:
        synthesizer_for()
    except SynthesisError as missing:
        pytest.skip(str(missing))


@pytest.fixture
def nothing_armed(monkeypatch):
    """The face was never assembled: no servo can have been told anything."""

    def refuse(*_arguments, **_options):
        raise AssertionError("the face was brought up")

    monkeypatch.setattr("lipservo.commands.run.run.run_face", refuse)
    monkeypatch.setattr("lipservo.runtime.processes.supervise", refuse)


def answer(*arguments):
    done = lipservo(*arguments)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def refused(*arguments):
    """The one line with which a whole command line is refused, and its exit status."""
    done = lipservo(*arguments)
    (line,) = [each for each in done.stderr.splitlines() if each.startswith("lipservo: ")]
    return line, done.returncode


@pytest.mark.usefixtures("_espeak")
def test_say_moves_the_mouth_by_the_phonemes_of_its_text():
    told = answer("say", "--mute", "Maybe.", "--json")
    assert told["phonemes"] >= 4
    assert told["status"]["listens_on"] is None


@pytest.mark.usefixtures("_espeak", "nothing_armed")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--", text], "write words") for text in ("", "   ", "--- ...")]
    + [(["hello", "--language", "klingonese"], "klingonese")],
)
def test_a_text_or_language_that_cannot_be_spoken_is_refused(arguments, said):
    line, status = refused("say", "--mute", *arguments)
    assert said in line
    assert status == 1


@pytest.mark.usefixtures("nothing_armed")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "--output", "x"], "--output: `sound.output:` in the face's YAML"),
        (["daemon", "--output", "x"], "--output: `sound.output:` in the face's YAML"),
        (["run", "--phonemes", "x.TextGrid"], "--phonemes needs --wav"),
        (["say", "hello", "--mute", "--output", "x"], "--mute or --output"),
        (["daemon", "--listen", "none", "--sounds", "."], "with --listen none leave out --sounds"),
        (
            ["daemon", "--listen", "0.0.0.0:0", "--open-to-this-computer"],
            "0.0.0.0:0: can be reached from other computers",
        ),
        (
            ["daemon", "--token-file", "token", "--open-to-this-computer"],
            "give --token-file or --open-to-this-computer",
        ),
        (["run", "--open-to-this-computer"], "`lipservo daemon --dashboard` and"),
        (
            ["daemon", "--listen", "none", "--token-file", "t"],
            "with --listen none leave out --sounds",
        ),
        (["daemon", "--listen", "nowhere"], "write HOST:PORT"),
        (["daemon", "--listen", "127.0.0.1:99999"], "write HOST:PORT"),
        (["daemon", "--token-file", "none.txt"], "none.txt"),
        (["daemon", "--token-file", "empty"], "its first line is empty; write the token there"),
        (["run", "--wav", CLIP_PATH, "--phonemes", "other.TextGrid"], "other.TextGrid"),
    ],
)
def test_options_that_cannot_be_or_not_together_are_refused_in_one_line(
    arguments, said, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").write_text("\n")
    (tmp_path / "other.TextGrid").write_text("no TextGrid\n")
    line, status = refused(*arguments)
    assert said in line
    assert status != 0


def test_a_file_of_a_synthesiser_is_said_with_the_sound_beside_it(tmp_path):
    visemes = [{"audioOffset": n * 1_000_000, "visemeId": 21 if n % 2 else 2} for n in range(8)]
    (tmp_path / "line.json").write_text(json.dumps(visemes))
    soundfile.write(tmp_path / "line.wav", np.full(12_800, 0.1), 16_000)

    told = answer("say", "--mute", "--from", tmp_path / "line.json", "--json")
    assert told["phonemes"] >= 8


@pytest.mark.usefixtures("nothing_armed")
@pytest.mark.parametrize(
    ("content", "line"),
    [
        (
            '[{"audioOffset": 0, "visemeId": 99}]',
            "viseme 1 at 0.000 s: '99' is not a viseme of azure",
        ),
        ('[{"word": "b", "start": 2}, {"word": "a", "start": 1}]', "word 2 begins at 1.000 s"),
    ],
)
def test_a_file_that_cannot_be_said_is_one_line(tmp_path, content, line):
    (tmp_path / "line.json").write_text(content)
    soundfile.write(tmp_path / "line.wav", np.full(1600, 0.1), 16_000)

    told, status = refused("say", "--mute", "--from", tmp_path / "line.json")
    assert line in told
    assert status == 1


@pytest.mark.usefixtures("nothing_armed")
@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((), "give a text or --from FILE"),
        (("hello", "--from", "x.json"), "give a text or --from FILE"),
        (("--from", "x.json", "--through", "ws://127.0.0.1:1"), "a text or --from FILE"),
        (("--from", "x.json"), "no sound beside it; put it there as x with .wav"),
    ],
)
def test_say_takes_a_text_or_a_file_that_has_its_sound(arguments, line):
    told, _ = refused("say", *arguments)
    assert line in told


@pytest.mark.usefixtures("_espeak", "nothing_armed")
@pytest.mark.parametrize("arguments", [["run", "--play"], ["say", "hello"]])
def test_without_any_loudspeaker_a_command_says_how_to_do_without_sound(arguments, monkeypatch):
    install_sound_card(monkeypatch, [device(0, "mic", n_inputs=1)])
    line, status = refused(*arguments)
    assert "no loudspeaker" in line
    assert "--mute" in line
    assert status == 1


def test_a_sound_file_with_its_phonemes_moves_the_mouth_by_them(tmp_path):
    """The sound is a whisper without words: only the script can have moved it."""
    rate_hz = 16_000
    noise = 1e-3 * np.random.default_rng(0).standard_normal(round(CUT_S * rate_hz))
    soundfile.write(tmp_path / "short.wav", noise, rate_hz)
    script = read_phonemes(CLIP_LABELS_PATH)
    spoken = [each for each in script if each.start_s < CUT_S and each.phoneme != "SIL"]
    rows = [(each.phoneme, each.start_s, min(each.end_s, CUT_S)) for each in spoken]
    (tmp_path / "short.json").write_text(json.dumps({"phones": rows}))
    spoken_by = ("--phonemes", tmp_path / "short.json", "--json")
    told = answer("run", "--wav", tmp_path / "short.wav", *spoken_by)
    assert len(spoken) <= told["phonemes"] <= len(spoken) + 3
    assert len(spoken) >= 4


def test_a_running_face_says_what_it_is_given_if_the_token_is_right(tmp_path):
    token = tmp_path / "token"
    token.write_text("open sesame\n")
    settings = AgentSettings(policy=Policy("open sesame"))
    with ServedFace(settings, has_voice=True) as face:
        told = ("say", "Good morning.", "--through", face.url)
        done = lipservo(*told, "--token-file", token)
        assert (done.returncode, done.stdout) == (0, "played to its end: 1.3 s\n"), done.stderr
        line, status = refused(*told)
        heard = np.count_nonzero(face.sound.played()) / face.sound.rate_hz
    # The command returned when it was heard.
    assert heard == pytest.approx(1.3, abs=0.02)
    assert face.texts == ["Good morning."]
    assert status == 1
    assert line.startswith(f"lipservo: --through {face.url}: ")


@pytest.mark.usefixtures("nothing_armed")
@pytest.mark.parametrize("command", [("say", "Hi."), ("lines", "perform", "line.perf")])
def test_what_a_running_face_cannot_obey_is_refused_before_it_is_told_anything(
    tmp_path, monkeypatch, command
):
    """Above all --dry-run: it must move nothing."""
    monkeypatch.chdir(tmp_path)
    options = ["--dry-run", "--mute", "--config no_such", "--port /dev/x", "--trace t.jsonl",
               "--rate-hz 40", "--sim pty", "--osc localhost"]  # fmt: skip
    if command[0] == "say":
        options += ["--strength 1", "--from x.json", "--channel left"]
    with ServedFace(AgentSettings(), has_voice=True) as face:
        for option in options:
            told = (*command, "--json", "--through", face.url, *option.split())
            line, status = refused(*told)
            assert line.startswith(f"lipservo: {option.split()[0]}: not with --through")
            assert status == 2
    assert face.asked == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("how", [[], ["--json"]])
def test_what_was_not_played_to_its_end_is_no_success(how):
    """It is silenced while the command waits."""
    text = "Good morning, all of you. " * 30  # not all of it is synthesised by then
    with ServedFace(AgentSettings(), has_voice=True, step_s=0.001) as face:

        def silenced():
            with connect(face.url) as client:
                while not face.sound.played().any():
                    time.sleep(0.01)
                client.interrupt()

        with ThreadPoolExecutor(1) as pool:
            cut = pool.submit(silenced)
            done = lipservo("say", text, "--through", face.url, *how)
            cut.result(60.0)
    assert done.returncode == 1
    assert re.search("not played to its end, only [01]\\.[0-9] s of it", done.stderr)
    if how:
        told = json.loads(done.stdout)
        assert (told["finished"], told["is_whole"]) == (False, False)
        assert 0.0 < told["played_s"] < told["duration_s"]
    else:
        assert done.stdout == ""
