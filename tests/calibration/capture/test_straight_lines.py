"""Lines through captured markers: single wrong points do not bend them, and are counted."""

import numpy as np
import pytest

from calibration.capture.capture import Capture
from calibration.capture.straight_lines import straight_lines, without_far_points
from lipsync.markers import MARKERS_47

N_POSES, N_MARKERS = 60, 10
NAMES = MARKERS_47.names[:N_MARKERS]
NOISE_MM = 0.2
BY_DEG = 0.1 * np.random.default_rng(0).normal(size=(3, N_MARKERS, 3))


def capture_of(markers_mm=None, noise_mm=NOISE_MM) -> Capture:
    """Three joints that move ten markers in straight lines, from -20 to 20 degrees."""
    rng = np.random.default_rng(1)
    goals_deg = rng.uniform(-20, 20, (N_POSES, 3))
    goals_deg[0], goals_deg[1] = -20.0, 20.0
    if markers_mm is None:
        markers_mm = 50.0 + np.einsum("ns,smk->nmk", goals_deg, BY_DEG)
        markers_mm = markers_mm + rng.normal(0.0, noise_mm, markers_mm.shape)
    return Capture(("a", "b", "c"), NAMES, goals_deg, np.ones((N_POSES, 3)), markers_mm)


def test_without_noise_the_lines_are_the_robots():
    lines = straight_lines(capture_of(noise_mm=0.0))
    assert lines.slopes_mm == pytest.approx(40.0 * BY_DEG, abs=1e-6)
    assert lines.noise_mm == pytest.approx(0.0, abs=1e-6)
    assert not lines.far.any()


def test_noise_is_measured_for_all_and_for_each():
    capture = capture_of()
    shaken_mm = capture.markers_mm.copy()
    shaken_mm[:, 4] += np.random.default_rng(5).normal(0.0, 1.0, (N_POSES, 3))
    assert straight_lines(capture).noise_mm == pytest.approx(NOISE_MM, rel=0.1)
    own_mm = straight_lines(capture_of(shaken_mm)).own_noise_mm
    assert own_mm[4] == pytest.approx(np.hypot(NOISE_MM, 1.0), rel=0.2)
    assert np.delete(own_mm, 4) == pytest.approx(NOISE_MM, rel=0.25)


def test_what_chance_gives_a_slope_is_what_it_gives():
    """Over drawn noise: the spread of a slope that is not there."""
    clean = capture_of(noise_mm=0.0)
    slopes_mm, told_mm = [], []
    for seed in range(20):
        noise_mm = np.random.default_rng([seed, 2]).normal(0.0, 1.0, clean.markers_mm.shape)
        lines = straight_lines(capture_of(noise_mm))
        slopes_mm.append(lines.slopes_mm)
        told_mm.append(lines.chance_mm)
    spread_mm = np.sqrt(np.mean(np.square(slopes_mm), axis=(0, 2, 3)))
    assert np.mean(told_mm, axis=0) == pytest.approx(spread_mm, rel=0.15)


def test_points_far_off_are_left_out_counted_by_marker_and_bend_nothing():
    clean = capture_of()
    wrong_mm = clean.markers_mm.copy()
    wrong_mm[[3, 9, 20], 2] += [0.0, 25.0, 0.0]
    wrong_mm[40, 7] = [1e30, 0.0, 0.0]
    wrong_mm[50, 1] = np.nan  # lost, not far off
    capture = capture_of(wrong_mm)

    lines = straight_lines(capture)
    kept, (warning,) = without_far_points(capture, lines)

    lost = np.isnan(kept.markers_mm).any(axis=2)
    assert {(int(p), int(m)) for p, m in np.argwhere(lost)} == {
        (3, 2), (9, 2), (20, 2), (40, 7), (50, 1),
    }  # fmt: skip
    assert warning == (f"4 readings were far off and left out: {NAMES[2]} 3, {NAMES[7]} 1")
    assert lines.slopes_mm == pytest.approx(straight_lines(clean).slopes_mm, abs=0.15)
    assert np.array_equal(capture.markers_mm, wrong_mm, equal_nan=True)  # as it came


def test_of_many_markers_with_such_points_the_worst_are_told():
    wrong_mm = capture_of().markers_mm.copy()
    for marker in range(7):
        wrong_mm[10 : 11 + marker, marker] += 30.0
    capture = capture_of(wrong_mm)
    _, (warning,) = without_far_points(capture, straight_lines(capture))
    told = ", ".join(f"{NAMES[m]} {m + 1}" for m in (6, 5, 4, 3, 2))
    assert warning == f"28 readings were far off and left out: {told}, ..."


def test_a_sound_capture_stays_as_it_is():
    capture = capture_of()
    assert without_far_points(capture, straight_lines(capture)) == (capture, ())
