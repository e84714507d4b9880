"""Healthy robots before worse trackers are not refused, and a dead joint before one is."""

import numpy as np
import pytest
from lipservo_lab.bench.calibration import hard_captures
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot
from lipservo_lab.bench.calibration.hard_captures import refusals

from calibration.simulated.elastic_robot import ElasticFace
from lipsync.animpho.units import load_face_with_animphos

MODEL = load_face_with_animphos()


def drawn(seed, n_servos):
    draw, servos = draw_elastic_robot(MODEL.markers_mm(MODEL.rest[None])[0], seed, n_servos)
    return ElasticFace(draw), servos


@pytest.mark.slow
def test_a_healthy_robot_of_ten_weak_servos_is_refused_before_none():
    face, servos = drawn(104, 10)
    told = refusals(MODEL, face, servos, 104)
    assert told == {"15 markers": None, "1 mm of noise": None, "1 % of outliers": None}


@pytest.mark.slow
def test_a_dead_joint_is_refused_before_all_and_named(monkeypatch):
    face, servos = drawn(109, 4)
    dead = servos.names.index("m4_smile")

    class Robot(hard_captures.SimulatedRobot):
        def move(self, positions_deg):
            super().move(np.where(np.arange(4) == dead, 0.0, positions_deg))
            return positions_deg

    monkeypatch.setattr(hard_captures, "SimulatedRobot", Robot)
    told = refusals(MODEL, face, servos, 109)
    assert len(told) == 3
    for why in told.values():
        assert "'m4_smile' moves no marker" in str(why)


@pytest.mark.parametrize("seed", range(3))
def test_one_reading_in_a_hundred_is_wild(seed):
    rng = np.random.default_rng(seed)
    still_mm = np.zeros((47, 3))
    wild = [hard_captures._with_outliers(still_mm, rng).any(axis=1) for _ in range(400)]
    assert np.mean(wild) == pytest.approx(0.01, abs=0.002)
