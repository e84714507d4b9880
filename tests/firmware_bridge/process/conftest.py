"""Faces under a supervisor, for every test of it."""

import pytest
from simulated_supervisor import SupervisedFace

from firmware_bridge.process.lifeline import Ready


@pytest.fixture
def starting_face(tmp_path):
    """Nothing was heard of its bridge yet."""
    face = SupervisedFace(tmp_path / "face.sock")
    with face.control:
        yield face


@pytest.fixture
def face(starting_face):
    """A face that runs well."""
    starting_face.play()
    starting_face.bridge.said.append(Ready())
    starting_face.play()
    return starting_face
