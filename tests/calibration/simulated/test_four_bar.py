"""A four-bar linkage: triangles by hand, Freudenstein's equation, and a jaw that only opens."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.simulated.elastic_robot import FourBar

SERVO_DEG = np.linspace(-3.3, 26.4, 100)


def can_turn(links):
    """The crank's end never gets further from the rocker's axis than rod and rocker stretched."""
    crank = np.deg2rad(links.start_deg + SERVO_DEG)
    x_mm = links.ground_mm - links.crank_mm * np.cos(crank)
    reach_mm = np.hypot(x_mm, links.crank_mm * np.sin(crank))
    return reach_mm.max() <= links.rod_mm + links.rocker_mm


#: What the elastic robots are drawn from, without what is stretched before its servo's end.
LINKS = st.builds(
    lambda crank_mm, longer, rod_mm, ground_mm, start_deg: FourBar(
        crank_mm, rod_mm, crank_mm * longer, ground_mm, start_deg
    ),
    st.floats(16.0, 22.0),
    st.floats(0.95, 1.25),
    st.floats(38.0, 48.0),
    st.floats(40.0, 46.0),
    st.floats(60.0, 95.0),
).filter(can_turn)


def test_a_parallelogram_turns_the_jaw_as_the_servo():
    parallel = FourBar(crank_mm=20.0, rod_mm=40.0, rocker_mm=20.0, ground_mm=40.0, start_deg=80.0)
    assert parallel.jaw_deg(SERVO_DEG) == pytest.approx(SERVO_DEG, abs=1e-9)


def test_two_triangles_by_hand():
    """Crank 3 upright, ground 4: the rocker of 6 stands upright as well, its rod (4, 3) is 5.

    The crank then lies flat, 7 from the rocker's axis: the rocker's angle to the ground is that of
    a triangle 6, 7, 5, whose cosine is (36 + 49 - 25) / 84; it stood at 90 degrees.
    """
    links = FourBar(crank_mm=3.0, rod_mm=5.0, rocker_mm=6.0, ground_mm=4.0, start_deg=90.0)
    expected_deg = 90.0 - np.rad2deg(np.arccos(60.0 / 84.0))
    assert links.jaw_deg(np.array([0.0, 90.0])) == pytest.approx([0.0, expected_deg], abs=1e-9)
    assert expected_deg == pytest.approx(45.585, abs=1e-3)


def test_links_that_do_not_reach_say_so():
    """Crank 3 and ground 4: the end is 7 away when it lies flat behind, rod and rocker reach 6."""
    short = FourBar(crank_mm=3.0, rod_mm=3.0, rocker_mm=3.0, ground_mm=4.0, start_deg=90.0)
    assert short.can_turn(np.array([0.0, 20.0]))
    assert not short.can_turn(np.array([0.0, 90.0]))
    assert not short.can_turn(np.array([90.0, 0.0]))


@settings(deadline=None, max_examples=50)  # machines are shared
@given(links=LINKS)
def test_the_jaw_turns_with_the_servo_and_never_back(links):
    turned_deg = links.jaw_deg(SERVO_DEG)
    assert (np.diff(turned_deg) > 0.0).all()
    assert np.sign(turned_deg) == pytest.approx(np.sign(SERVO_DEG))


@settings(deadline=None, max_examples=50)
@given(links=LINKS)
def test_the_angles_satisfy_freudensteins_equation(links):
    """K1 cos(rocker) - K2 cos(crank) + K3 = cos(crank - rocker), from some rocker angle on.

    Where the rocker stands at 0 is found from the closed loop on its own: the rod's two ends.
    """
    crank = np.deg2rad(links.start_deg)
    k1, k2 = links.ground_mm / links.crank_mm, links.ground_mm / links.rocker_mm
    squares = links.crank_mm**2 + links.rocker_mm**2 + links.ground_mm**2 - links.rod_mm**2
    k3 = squares / (2.0 * links.crank_mm * links.rocker_mm)
    # a cos(rocker) - b sin(rocker) = c, the root whose rocker is on the crank's side of the ground.
    a, b, c = k1 - np.cos(crank), np.sin(crank), k2 * np.cos(crank) - k3
    begins = np.arccos(c / np.hypot(a, b)) - np.arctan2(b, a)
    rocker = begins + np.deg2rad(links.jaw_deg(SERVO_DEG))
    turned = np.deg2rad(links.start_deg + SERVO_DEG)
    left = k1 * np.cos(rocker) - k2 * np.cos(turned) + k3
    assert left == pytest.approx(np.cos(turned - rocker), abs=1e-9)
