from types import SimpleNamespace

import numpy as np
import pytest

from lipsync.twin.head_surface import cotangent_laplacian, influence, shell_stiffness, spread

SIDE = 41


def grid(width=1.0, curved=(0.0, 0.0)):
    """Return vertices (n, 3) and triangles of a square mesh of SIDE x SIDE vertices.

    curved: by how much z falls with x^2 and y^2. Diagonals alternate, so no direction is preferred.
    """
    line = np.linspace(-width, width, SIDE)
    x, y = (each.ravel() for each in np.meshgrid(line, line))
    corner = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    triangles = []
    for row in range(SIDE - 1):
        for column in range(SIDE - 1):
            a, b = corner[row, column], corner[row, column + 1]
            c, d = corner[row + 1, column], corner[row + 1, column + 1]
            if (row + column) % 2:
                triangles += [(a, b, d), (a, d, c)]
            else:
                triangles += [(a, b, c), (b, d, c)]
    return np.column_stack([x, y, -curved[0] * x**2 - curved[1] * y**2]), np.array(triangles)


@pytest.fixture(scope="module")
def head():
    """Half an ellipsoid with a slit for a mouth, symmetric about x = 0.

    Its vertices, number of each one's mirror image, handles round the mouth, anchors at the rim,
    stiffness, and the weights of the handles.
    """
    vertices, triangles = grid(70.0, curved=(0.006, 0.004))
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    row, slit = SIDE // 3, range(SIDE // 2 - 7, SIDE // 2 + 8)
    lower = np.arange(len(slit)) + len(vertices)
    vertices = np.vstack([vertices, vertices[number[row, slit]]])
    below = vertices[triangles].mean(axis=1)[:, 1] < vertices[number[row, 0], 1]
    inner = dict(zip(number[row, slit][1:-1].tolist(), lower[1:-1].tolist(), strict=True))
    triangles[below] = [[inner.get(v, v) for v in t] for t in triangles[below].tolist()]
    used_numbers, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    vertices = vertices[used_numbers]
    mirrored = vertices * (-1.0, 1.0, 1.0)
    # Both lips lie on one another: above stays above.
    first_lower = int((used_numbers < SIDE * SIDE).sum())
    mirror = np.array(
        [
            candidates[-1] if i >= first_lower else candidates[0]
            for i, place in enumerate(mirrored)
            for candidates in [np.flatnonzero(np.linalg.norm(vertices - place, axis=1) < 1e-9)]
        ]
    )
    upper_lip = number[row, [slit[3], slit[7], slit[11]]]
    lower_lip = first_lower + np.array([2, 6, 10])
    chin, cheeks = number[row - 6, [16, 20, 24]], number[row + 5, [10, 30]]
    handles = np.concatenate([upper_lip, lower_lip, chin, cheeks])
    anchors = np.flatnonzero(np.abs(vertices[:, :2]).max(axis=1) > 62.0)
    stiffness = shell_stiffness(vertices, triangles)
    return SimpleNamespace(
        vertices=vertices,
        mirror=mirror,
        handles=handles,
        anchors=anchors,
        held=np.concatenate([handles, anchors]),
        stiffness=stiffness,
        weights=influence(stiffness, handles, anchors),
    )


def test_the_laplacian_of_a_paraboloid_is_four():
    vertices, triangles = grid()
    laplacian, areas = cotangent_laplacian(vertices, triangles)

    curved = laplacian @ (vertices[:, 0] ** 2 + vertices[:, 1] ** 2)

    inside = np.abs(vertices[:, :2]).max(axis=1) < 0.9
    assert curved[inside].sum() / areas[inside].sum() == pytest.approx(4.0, rel=2e-3)
    assert areas.sum() == pytest.approx(4.0)


def test_a_clamped_disc_bends_as_plate_theory_says():
    """Lifted by 1 in its middle: 1 - s^2 + 2 s^2 ln s (Timoshenko, Plates, article 19)."""
    vertices, triangles = grid()
    radius = np.linalg.norm(vertices[:, :2], axis=1)
    anchors = np.flatnonzero(radius > 0.925)
    stiffness = shell_stiffness(vertices, triangles, membrane_per_mm2=0.0)

    bent = influence(stiffness, [int(radius.argmin())], anchors)[:, 0]

    share = np.clip(radius / 0.95, 1e-12, 1.0)
    expected = 1 - share**2 + 2 * share**2 * np.log(share)
    assert np.abs(bent - expected).max() < 0.03


def test_handles_go_where_they_are_told_and_anchors_stay(head):
    np.testing.assert_array_equal(head.weights[head.handles], np.eye(len(head.handles)))
    np.testing.assert_array_equal(head.weights[head.anchors], 0.0)
    assert head.weights.min() > -0.5
    assert head.weights.max() < 1.6


def test_what_is_solved_leaves_no_force_where_nothing_holds(head):
    free = np.setdiff1d(np.arange(len(head.vertices)), head.held)
    forces = np.abs(head.stiffness @ head.weights)
    assert forces[free].max() < 1e-9 * forces.max()


def test_moving_all_that_holds_moves_all(head):
    shift = np.array([3.0, -2.0, 1.0])

    moved = spread(head.stiffness, head.held, np.tile(shift, (len(head.held), 1)))

    np.testing.assert_allclose(moved, np.tile(shift, (len(head.vertices), 1)), atol=1e-6)


def test_displacements_are_linear_and_nothing_moves_when_nothing_is_moved(head):
    moves = np.random.default_rng(0).normal(size=(len(head.handles), 3))
    given = np.vstack([moves, np.zeros((len(head.anchors), 3))])

    moved = spread(head.stiffness, head.held, given)
    np.testing.assert_allclose(head.weights @ moves, moved, atol=1e-9)
    np.testing.assert_array_equal(spread(head.stiffness, head.held, 0 * given), 0.0)


def test_a_face_that_moves_alike_on_both_sides_stays_alike(head):
    moves = np.random.default_rng(1).normal(size=(len(head.handles), 3))
    position = {int(vertex): at for at, vertex in enumerate(head.handles)}
    partner = [position[int(head.mirror[vertex])] for vertex in head.handles]
    moves = (moves + moves[partner] * (-1.0, 1.0, 1.0)) / 2

    moved = head.weights @ moves

    # The diagonals of the triangles are not mirrored, so neither is the last digit.
    np.testing.assert_allclose(moved[head.mirror] * (-1.0, 1.0, 1.0), moved, atol=0.02)


def test_lips_on_one_another_move_apart(head):
    lower_lip_down = np.zeros((len(head.handles), 3))
    lower_lip_down[3:9, 1] = -10.0

    moved = head.weights @ lower_lip_down

    upper, lower = head.handles[1], head.handles[4]
    np.testing.assert_allclose(head.vertices[upper], head.vertices[lower])
    assert moved[upper, 1] - moved[lower, 1] == 10.0


def test_a_handle_that_stands_twice_is_refused(head):
    with pytest.raises(ValueError, match="twice"):
        influence(head.stiffness, [*head.handles, head.handles[0]], head.anchors)


def test_a_part_that_hangs_on_nothing_is_refused():
    vertices, triangles = grid()
    two = np.vstack([vertices, vertices + np.array([5.0, 0.0, 0.0])])
    stiffness = shell_stiffness(two, np.vstack([triangles, triangles + len(vertices)]))
    with pytest.raises(ValueError, match="has no handle"):
        influence(stiffness, [0], [1, 2, 3])
