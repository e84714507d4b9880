"""What `stop` says of a face that plays in this process: no more than its report says."""

import json
import time

import pytest
from playing_face import PATIENCE_S, invoke, playing, status

pytestmark = pytest.mark.usefixtures("own_folder")


@pytest.mark.parametrize(("before", "where"), [((), "at rest and limp"), (("--freeze",), "limp")])
@pytest.mark.parametrize("as_json", [False, True])
def test_a_face_is_at_rest_only_where_it_went_there(before, where, as_json):
    """A frozen one lets go where it is."""
    with playing():
        while status()["servos"] != {"jaw": "driven"}:
            pass
        if before:
            assert invoke("stop", *before).exit_code == 0
        done = invoke("stop", *(["--json"] if as_json else []))

    assert done.exit_code == 0
    if as_json:
        (face,) = json.loads(done.stdout)["faces"]
        assert face["at_rest"] is (where != "limp")
    else:
        assert f": {where}, confirmed by all 1 servos" in done.stdout


def test_a_dry_run_is_called_one_counts_no_servo_as_confirmed_and_ends_with_its_stop():
    """It does not wait for a start."""
    with playing(dry_run=True):
        shown, told = invoke("status").stdout, status()
        invoke("stop", "--freeze")
        done = invoke("stop")
        give_up_s = time.monotonic() + PATIENCE_S
        while json.loads(invoke("status", "--json").stdout)["faces"]:
            assert time.monotonic() < give_up_s
            time.sleep(0.05)

    assert "dry run: servos are only read" in shown
    assert told["dry_run"] is True
    assert done.exit_code == 0
    assert ": dry run over; no torque was switched on\n" in done.stdout
    assert "confirmed" not in done.stdout
    assert "start" not in done.stdout


def test_a_dry_run_is_called_one_in_json():
    with playing(dry_run=True):
        (face,) = json.loads(invoke("stop", "--json").stdout)["faces"]

    assert (face["dry_run"], face["at_rest"]) == (True, False)
