"""The solved skin: at rest where nothing pulls, stiff in every direction, two lips in one sheet."""

import numpy as np
import pytest
from small_model import small_model

from calibration.simulated.elastic_robot import N_PAIRS, POISSON, ElasticSkin, elastic_skin
from lipsync.markers import MARKERS_47

MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
GAPS_MM = np.linspace(0.2, 0.6, N_PAIRS)
OFF_EDGE_MM = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 1.0])


def row(landmark: int) -> int:
    return MARKERS_47.landmarks.index(landmark)


@pytest.fixture(scope="module")
def skin() -> ElasticSkin:
    return elastic_skin(REST_MM, GAPS_MM, OFF_EDGE_MM)


def sheet(skin: ElasticSkin) -> np.ndarray:
    """(3 n, 3 n): without the foam."""
    return skin.stiffness - np.diag(np.tile(skin.foam, 3))


def test_nothing_moves_where_nothing_pulls_and_every_pull_costs_work(skin):
    n = 3 * len(skin.places_mm)
    assert np.linalg.solve(skin.stiffness, np.zeros(n)) == pytest.approx(np.zeros(n))
    assert np.abs(skin.stiffness - skin.stiffness.T).max() < 1e-12
    np.linalg.cholesky(skin.stiffness)  # raises unless positive definite


def test_the_sheet_itself_resists_no_motion_as_a_whole(skin):
    """A patch test: moved or turned in its plane it has no strain, and even strains cost theirs."""
    n = len(skin.places_mm)
    plane = skin.places_mm[:, :2].copy()
    # The mesh alone has a slit of 0.75 mm on either side, whatever the lips' gaps.
    middle = (plane[:N_PAIRS] + plane[N_PAIRS : 2 * N_PAIRS]) / 2
    slit = np.array([0.0, 0.75])
    plane[:N_PAIRS], plane[N_PAIRS : 2 * N_PAIRS] = middle + slit, middle - slit
    zero, one = np.zeros(n), np.ones(n)
    for still in (
        np.concatenate([one, zero, zero]),
        np.concatenate([zero, one, zero]),
        np.concatenate([zero, zero, one]),
        np.concatenate([-plane[:, 1], plane[:, 0], zero]),
    ):
        assert sheet(skin) @ still == pytest.approx(0.0, abs=1e-9)

    def work(across: np.ndarray, up: np.ndarray) -> float:
        moved = np.concatenate([across, up, zero])
        return float(moved @ sheet(skin) @ moved)

    # Plane stress: E / (1 - nu^2), E, and the shear modulus E / (2 (1 + nu)), on the same area.
    x, y = plane.T
    stretched = work(x, zero)
    assert stretched > 1.0
    assert work(zero, y) == pytest.approx(stretched)
    assert work(x, -POISSON * y) == pytest.approx(stretched * (1.0 - POISSON**2))
    assert work(y, zero) == pytest.approx(stretched * (1.0 - POISSON) / 2.0)


def test_lips_part_by_their_gaps_and_hang_on_their_own_bone(skin):
    upper, lower = skin.places_mm[:N_PAIRS], skin.places_mm[N_PAIRS : 2 * N_PAIRS]
    assert upper[:, 1] - lower[:, 1] == pytest.approx(GAPS_MM)
    assert upper[:, ::2] == pytest.approx(lower[:, ::2])
    assert (skin.jaw_share[:N_PAIRS] == 0.0).all()
    assert (skin.jaw_share[N_PAIRS : 2 * N_PAIRS] == 1.0).all()
    assert ((skin.jaw_share >= 0.0) & (skin.jaw_share <= 1.0)).all()


def test_a_lip_that_is_pulled_leaves_the_other_behind(skin):
    """Along the slit nothing holds them together but the corners."""
    n = len(skin.places_mm)
    pull = np.zeros(3 * n)
    pull[n + N_PAIRS // 2] = 1.0
    moved = np.linalg.solve(skin.stiffness, pull)[n : 2 * n]
    assert moved[N_PAIRS // 2] > 5.0 * abs(moved[N_PAIRS + N_PAIRS // 2]) > 0.0


def test_dots_are_means_of_skin_and_the_inner_lips_lie_off_the_edge(skin):
    assert skin.dots.sum(axis=1) == pytest.approx(1.0)
    assert (skin.dots >= -1e-9).all()
    others = [i for i, n in enumerate(MARKERS_47.landmarks) if n not in (82, 13, 312, 87, 14, 317)]
    assert (skin.dots @ skin.places_mm)[others] == pytest.approx(REST_MM[others], abs=1e-6)
    assert skin.dots_mm[others] == pytest.approx(REST_MM[others])
    middle_mm = skin.dots_mm[row(13), 1] - skin.dots_mm[row(14), 1]
    assert middle_mm == pytest.approx(GAPS_MM[N_PAIRS // 2] + OFF_EDGE_MM[1] + OFF_EDGE_MM[4])


@pytest.mark.parametrize(("below", "other"), [(True, slice(0, 9)), (False, slice(9, 18))])
def test_a_rod_at_a_lip_leaves_the_other_lip_alone(skin, below, other):
    place_mm = REST_MM[row(17 if below else 0)]
    patch = skin.patch(place_mm, below)
    assert patch.sum() == pytest.approx(1.0)
    assert (patch[other] == 0.0).all()
    assert patch.argmax() == np.linalg.norm(skin.places_mm - place_mm, axis=1).argmin()
    assert (skin.patch(place_mm, None)[other] > 0.0).any()
