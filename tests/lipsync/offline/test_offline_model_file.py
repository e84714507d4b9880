"""The shipped offline model, and files that are none."""

import json
from importlib import resources
from zipfile import ZipFile

import numpy as np
import pytest

from lipsync.face.model import load_face
from lipsync.offline.offline_model import OfflineModelError
from lipsync.offline.offline_model_file import (
    SHIPPED,
    load_offline_model,
    save_offline_model,
)

PLACE = resources.files("lipsync.models") / f"{SHIPPED}.npz"


def test_the_shipped_model_goes_with_the_shipped_face_and_is_small():
    model = load_offline_model()

    model.check_face(load_face(), "shipped")
    assert len(PLACE.read_bytes()) < 12e6
    assert model.states.n_states == model.provenance["states"]
    assert model.states.follows.any(axis=1).all()


def test_what_is_read_is_written_again_the_same(tmp_path):
    again = tmp_path / "again.npz"
    save_offline_model(load_offline_model(), again)

    # Not the bytes of the archive: versions of Python and zlib pack differently.
    assert unpacked(again) == unpacked(PLACE)


def unpacked(place):
    with place.open("rb") as file, ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def rewritten(path, change):
    """Write the shipped model to `path`, changed by `change(about, arrays)` in place."""
    with np.load(PLACE) as archive:
        arrays = dict(archive)
    about = json.loads(arrays["about"].tobytes())
    change(about, arrays)
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda about, _: about.update(version=9), "offline model version 9"),
        (lambda about, _: about.update(kind="else"), "not an offline model"),
        (lambda about, _: about.update(phonemes=["A"]), "phonemes are not those"),
        (lambda _, a: a.update({"states/means": a["states/means"][:-1]}), "states/follows"),
        (lambda _, a: a.update({"states/states": a["states/states"] + 1}), "does not exist"),
        (lambda _, a: a.pop("units/end"), "units/end"),
        (lambda _, a: a.update({"sound/layer0": a["sound/layer0"] * np.nan}), "not finite"),
    ],
)
def test_a_model_that_cannot_be_used_says_what_is_wrong_in_one_line(tmp_path, change, message):
    path = tmp_path / "wrong.npz"
    rewritten(path, change)

    with pytest.raises(OfflineModelError) as raised:
        load_offline_model(path)

    assert message in str(raised.value)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)
