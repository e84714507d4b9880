"""The wheels hold what they must, and run in an empty environment: first without the lab."""

import json
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from places import ROOT

SAID = "Hello, I am a robot with a mouth."
SOURCES = {"config": "lipservo.config"}


def test_every_package_folder_is_listed_in_pyproject():
    """The list is explicit, so a forgotten sub-package would be missing from the wheel only."""
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())
    listed = set(pyproject["tool"]["setuptools"]["packages"])
    found = set()
    for top in ("calibration", "config", "firmware_bridge", "lipservo", "lipsync"):
        for init in (ROOT / top).rglob("__init__.py"):
            name = ".".join(init.parent.relative_to(ROOT).parts)
            found.add(SOURCES.get(name, name))
    assert listed == found


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--outdir", str(out), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    (built,) = out.glob("*.whl")
    return built


@pytest.mark.packaging
def test_the_wheel_holds_data_and_no_top_level_config(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {
        "calibration", "firmware_bridge", "lipservo", "lipsync",
    }  # fmt: skip
    for needed in (
        "firmware_bridge/dynamixel/control_tables.yaml",
        "lipservo/config/lipservo.service",
        "lipservo/config/face_sim.yaml",
        "lipservo/config/face_sim.calibration.yaml",
        "lipservo/clips/welcome.flac",
        "lipsync/models/grid_s1.npz",
        "lipsync/models/grid_s1.md",
        "lipsync/models/mean_face.npz",
        "lipsync/models/mean_face.md",
        "lipsync/models/recognizer.npz",
        "lipsync/models/recognizer.md",
        "lipsync/models/recognizer_grid.npz",
        "lipsync/models/recognizer_grid.md",
        "lipservo/dashboard/twin/twin.js",
        "lipservo/dashboard/twin/picture/index.js",
        "lipservo/py.typed",
    ):
        assert needed in names


class Environment:
    """A virtual environment of its own, with nothing in it but what `install` brings."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._bin = folder / "venv" / "bin"
        venv.create(folder / "venv", with_pip=True)

    def install(self, *requirements: str) -> None:
        command = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements]
        subprocess.run([self._bin / "python", *command], check=True, capture_output=True)

    def command(self, *arguments: object) -> list[str]:
        return [str(self._bin / "lipservo"), *map(str, arguments)]

    def lipservo(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.command(*arguments), capture_output=True, text=True, cwd=self.folder, timeout=300
        )

    def succeeds(self, *arguments: object) -> str:
        done = self.lipservo(*arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def python(self, script: str) -> str:
        command = [str(self._bin / "python"), "-c", script]
        how = {"capture_output": True, "text": True, "cwd": self.folder}
        return subprocess.run(command, check=True, **how).stdout


@pytest.fixture(scope="module")
def alone(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """The wheel and its client, in one call of pip, without any extra and without the lab."""
    environment = Environment(tmp_path_factory.mktemp("alone"))
    environment.install(str(wheel), str(ROOT / "client"))
    return environment


@pytest.fixture(scope="module")
def short_clip(alone: Environment) -> Path:
    """The first sentence of the bundled clip."""
    path = alone.folder / "short.wav"
    alone.python(
        "import soundfile; from importlib.resources import files\n"
        "samples, rate_hz = soundfile.read(files('lipservo.clips') / 'welcome.flac')\n"
        f"soundfile.write({str(path)!r}, samples[: int(2.43 * rate_hz)], rate_hz)"
    )
    return path


_HELP_OF_EVERY_COMMAND = """
import sys
import typer
from lipservo import cli
from lipservo.__main__ import main
from lipservo.commands.lazy_group import LazyGroup

def names(group):
    for name in group.list_commands(None):
        if not group.table[name].target:
            continue
        yield [name]
        below = group.get_command(None, name)
        for words in names(below) if isinstance(below, LazyGroup) else ():
            yield [name, *words]

for words in [[], *names(typer.main.get_command(cli.app))]:
    sys.argv = ["lipservo", *words, "--help"]
    try:
        main()
    except SystemExit as end:
        assert not end.code, words
    print("told", *words)
"""


@pytest.mark.packaging
def test_the_wheel_alone_knows_the_help_of_every_command(alone):
    printed = alone.python(_HELP_OF_EVERY_COMMAND)
    told = {line for line in printed.splitlines() if line.startswith("told")}
    assert {"told", "told run", "told calibrate", "told lines align", "told calibrate fit"} <= told
    assert len(told) > 30
    assert "Usage: lipservo [OPTIONS]" in alone.succeeds()


@pytest.mark.packaging
def test_the_wheel_alone_runs_the_main_job(alone):
    summary = json.loads(alone.succeeds("run", "--json"))
    assert summary["source"] == "welcome.flac"
    # A busy computer misses ticks, half of them once, and hears all of the sound even so.
    assert summary["frames_sent"] > 30
    assert summary["phonemes"] > 40
    assert summary["stop"]["complete"]


@pytest.mark.packaging
def test_the_wheel_alone_simulates_examines_and_moves_servos(alone):
    command = alone.command("sim-bus", "--config", "face_sim", "--until-stdin-closes")
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=alone.folder
    ) as simulator:
        port = simulator.stdout.readline().strip()
        assert json.loads(alone.succeeds("doctor", "--port", port, "--json"))["bad"] == 0
        assert "jaw stands at" in alone.succeeds("jog", "jaw", "-1", "--port", port)
        simulator.stdin.close()


@pytest.mark.packaging
def test_the_wheel_alone_names_the_extra_that_fits(alone, short_clip):
    for words in (
        ("calibrate", "fit", "--config", "face_jaw", "-o", alone.folder / "a.calibration.yaml"),
        ("lines", "render", short_clip, "-o", alone.folder / "line.perf"),
    ):
        done = alone.lipservo(*words)
        assert done.returncode == 1
        assert "`pip install 'lipservo[fit]'`" in done.stderr


@pytest.fixture(scope="module")
def fit(alone: Environment, wheel: Path) -> None:
    """Change the environment: scikit-learn and scipy are there from here on."""
    alone.install(f"{wheel}[fit]", str(ROOT / "client"))


@pytest.mark.packaging
@pytest.mark.usefixtures("fit")
def test_with_its_extra_fit_it_renders_a_line_and_performs_it(alone, short_clip):
    line = alone.folder / "line.perf"
    alone.succeeds("lines", "render", short_clip, "-o", line)
    told = json.loads(alone.succeeds("lines", "perform", line, "--mute", "--json"))
    assert told["stop"]["complete"]


@pytest.mark.packaging
@pytest.mark.usefixtures("fit")
def test_with_its_extra_fit_it_calibrates_and_speaks_with_what_it_made(alone, short_clip):
    face = alone.folder / "my_face.yaml"
    shipped = "from importlib.resources import files; print(files('lipservo.config'))"
    text = (Path(alone.python(shipped).strip()) / "face_jaw.yaml").read_text()
    made = "my_face.calibration.yaml"
    face.write_text(text.replace("face_jaw.calibration.yaml", made))
    told = alone.succeeds(
        "calibrate", "fit", "--config", face, "--no-lags", "-o", alone.folder / made
    )
    assert made in told
    alone.succeeds("replay", short_clip, "--config", face, "-q")


@pytest.mark.packaging
def test_with_the_lab_an_absent_extra_is_one_line_that_names_it(alone, short_clip):
    """Changes the environment: the lab is there from here on."""
    alone.install(str(ROOT / "lab"))
    assert "motion" in alone.succeeds("bench", "--help")
    log = alone.folder / "log.jsonl"
    log.write_text('{"step": 1, "loss": 2.0}\n')
    line_file = alone.folder / "l.perf"
    by_model = ("lines", "render", short_clip, "-o", line_file, "--method", "model-based")
    for extra, arguments in {
        "lipservo[align]": ("lines", "align", short_clip, SAID),
        "lipservo-lab[train]": ("learn", "recognizer", alone.folder, "-o", alone.folder / "w.npz"),
        "lipservo[plots]": ("learn", "plot", log, "-o", alone.folder / "log.png"),
        "lipservo[video]": ("learn", "import-video", alone.folder, "-o", alone.folder / "corpus"),
        "lipservo[offline]": by_model,
    }.items():
        done = alone.lipservo(*arguments)
        (line,) = done.stderr.splitlines()
        assert done.returncode == 1
        assert line.startswith("lipservo: ")
        assert f"`pip install '{extra}'`" in line


@pytest.mark.packaging
def test_with_its_extra_align_finds_words_and_guesses_others(alone, wheel, short_clip):
    """Last, for it changes the environment."""
    alone.install(f"{wheel}[align]", str(ROOT / "client"))
    assert "HH" in alone.succeeds("lines", "align", short_clip, SAID)
    said = (ROOT / "lipservo" / "clips" / "welcome.txt").read_text()
    clip = ROOT / "lipservo" / "clips" / "welcome.flac"
    told = json.loads(alone.succeeds("lines", "align", clip, said, "--json"))
    assert told["guessed"] == ["lipservo"]
