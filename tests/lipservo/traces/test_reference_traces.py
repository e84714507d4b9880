"""Three sounds move the face as they did when their traces were recorded; docs/traces.md."""

import pytest
from make_reference_traces import FOLDER, replay
from reference_sounds import SOUNDS
from typer.testing import CliRunner

from lipservo.cli import app

#: Far below what anybody sees and above what another NumPy rounds: with OpenBLAS's kernels for
#: Prescott, Haswell and Skylake the traces are the same to the byte.
TOLERANCES = ("--tolerance-mm", "0.02", "--tolerance-ms", "0.5", "--tolerance-deg", "0.1")


@pytest.mark.parametrize("name", SOUNDS)
def test_a_known_sound_moves_the_face_as_it_did(tmp_path, name):
    found = replay(name, tmp_path)

    done = CliRunner().invoke(
        app, ["trace", "diff", str(FOLDER / f"{name}.jsonl.gz"), str(found), *TOLERANCES]
    )

    assert done.exit_code == 0, f"{done.output}\nif this is meant: make traces"


def test_the_references_are_small():
    assert sum(file.stat().st_size for file in FOLDER.iterdir()) < 400_000
