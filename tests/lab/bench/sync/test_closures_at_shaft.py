"""`lipservo bench sync --face`: lips meet at the shafts of hobby servos as on Dynamixels."""

import json

import pytest
from typer.testing import CliRunner

from lipservo.cli import app


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "face_jaw_feetech",
        "face_head_mixed",
    ],
)
def test_closures_are_met_at_the_shaft(name):
    done = CliRunner().invoke(app, ["bench", "sync", "--face", name, "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)

    assert told["closures"] >= 10
    assert told["closures_at_shaft_on_dynamixel"] >= 0.9 * told["closures"]
    assert told["closures_at_shaft_share"] >= 0.95


def test_two_benches_at_once_are_refused():
    done = CliRunner().invoke(app, ["bench", "sync", "--face", "face_jaw", "--quick"])

    assert done.exit_code != 0
