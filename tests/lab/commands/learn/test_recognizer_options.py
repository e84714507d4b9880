"""What `train-recognizer` refuses before it works."""

import pytest
from typer.testing import CliRunner

from lipservo.cli import app

pytest.importorskip("torch", reason="the extra `train` is not installed")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--synthetic", "nobody:amy"], "is no SYNTHESISER:VOICE"),
        (["--noise", "{folder}/none"], "none: no such folder"),
        (["--noise", "{folder}/empty"], "holds no sound file"),
        (["--delays", "2,x"], "--delays 2,x: give numbers from 0 to 200"),
        (["--delays", "2,900"], "--delays 2,900: give numbers from 0 to 200"),
        (["--teacher", "{folder}/none.npz"], "none.npz: no such file"),
        (
            ["--start-from", "default", "--start-share", "0.3", "--delays", "60"],
            "leave out --start-share or --delays",
        ),
        (["--held-out", "{folder}/none.csv"], "cannot be read as a table of speakers"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(tmp_path, options, told):
    (tmp_path / "empty").mkdir()
    given = [option.format(folder=tmp_path) for option in options]
    done = CliRunner().invoke(
        app,
        [
            *("learn", "recognizer", str(tmp_path), "-o", str(tmp_path / "my.npz")),
            *("--folder", str(tmp_path / "run"), "-q", *given),
        ],
    )
    assert done.exit_code == 1
    assert told in str(done.exception)
    assert "\n" not in str(done.exception)
    assert not (tmp_path / "my.npz").exists()
