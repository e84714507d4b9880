"""What the page says of a calibration, and whether the commands that it names exist."""

import re
import shlex
from importlib import resources

import numpy as np
import pytest
import typer

from calibration.files.calibration_file import parse_calibration
from lipservo.cli import app
from lipservo.dashboard.pages.calibrate_page import (
    PULSE_STEPS,
    STEPS,
    read_calibration,
    steps_of,
)
from lipservo.dashboard.pages.pages import COMMAND
from lipsync.face.model import load_face


def test_the_calibration_of_a_shipped_face_is_read():
    told, trouble = read_calibration("face_head")

    assert trouble is None
    assert told["fits_the_face"] is True
    assert told["file"] == "face_sim.calibration.yaml"


@pytest.mark.parametrize("config", ["face_head", "face_jaw", "face_lips"])
def test_a_pose_that_a_page_gets_with_its_lip_gap_is_that_of_a_face_with_this_gap(config):
    told, _ = read_calibration(config)
    lips, path = told["lip_gap"], resources.files("lipservo.config") / told["file"]
    calibration, model = parse_calibration(path.read_text(), told["file"]), load_face()
    wide, shut = (lips["gaps_mm"].index(end(lips["gaps_mm"])) for end in (max, min))

    assert tuple(lips["servos"]) == calibration.servo_names
    assert lips["gaps_mm"][wide] > 8.0 > 2.0 > lips["gaps_mm"][shut]
    at_rest_deg = calibration.positions_deg(model.rest)
    far_deg = np.abs(np.array(lips["poses_deg"]) - at_rest_deg).sum(axis=1)
    assert far_deg[wide] > far_deg[shut]


@pytest.mark.parametrize(
    ("config", "why"),
    [
        (None, "this face has not told where its YAML is"),
        ("nobody", "no shipped face is called 'nobody'"),
    ],
)
def test_why_there_is_none_is_said(config, why):
    told, trouble = read_calibration(config)

    assert told is None
    assert why in trouble


@pytest.mark.parametrize("line", [step[3] for step in (*STEPS, *PULSE_STEPS.values())] + [COMMAND])
def test_a_command_that_a_page_names_exists_with_its_options(line):
    program, *words = shlex.split(line.format(face="face_sim"))
    command = typer.main.get_command(app)
    while hasattr(command, "get_command"):
        command = command.get_command(None, words.pop(0))

    known = {flag for parameter in command.params for flag in parameter.opts}
    assert program == "lipservo"
    assert {word for word in words if word.startswith("-")} <= known


def test_hobby_servos_are_offered_every_way_but_those_that_ask_where_they_stand():
    told = {
        has_place: re.sub(r"<[^>]*>", "", steps_of("mine.yaml", has_place=has_place))
        for has_place in (True, False)
    }

    for words in ("calibrate measure", "calibrate guided"):
        assert words in told[True]
        assert words in told[False]
    assert "jog --limp" in told[True]
    assert "jog --limp" not in told[False]
    assert "--lag-ms jaw=60" in told[False]
