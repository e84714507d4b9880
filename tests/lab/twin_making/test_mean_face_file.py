import numpy as np
import pytest
from lipservo_lab.twin_making.mean_face_file import main, repaired, subdivide, through_points

from lipsync.twin.head_surface import N_SKIN, load_mean_face

trimesh = pytest.importorskip("trimesh")


@pytest.fixture(scope="module")
def sphere():
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=50.0)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)


def test_a_ring_of_edges_that_is_no_triangle_is_left_out(sphere):
    vertices, triangles = sphere
    # A vertex of three triangles, so that the edges round it look like a fourth.
    a, b, c = triangles[0]
    new = len(vertices)
    split = np.array([(a, b, new), (b, c, new), (c, a, new)])
    whole = np.vstack([triangles[1:], split])

    found = repaired(np.vstack([whole, [(a, b, c)]]))

    assert {frozenset(map(int, t)) for t in found} == {frozenset(map(int, t)) for t in whole}


def test_triangles_are_turned_as_most_of_them_are(sphere):
    vertices, triangles = sphere
    mixed = triangles.copy()
    mixed[::7] = mixed[::7, ::-1]

    found = repaired(mixed)

    mesh = trimesh.Trimesh(vertices, found, process=False)
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0


def test_old_vertices_keep_their_numbers_and_columns_go_together(sphere):
    vertices, triangles = sphere
    columns = np.column_stack([vertices, vertices[:, 0]])

    fine, fine_triangles = subdivide(columns, triangles, rounds=2)

    assert len(fine_triangles) == 16 * len(triangles)
    np.testing.assert_allclose(fine[:, 3], fine[:, 0], atol=1e-9)
    assert np.linalg.norm(fine[: len(vertices), :3] - vertices, axis=1).max() < 5.0


def test_the_surface_comes_to_the_points_round_by_round(sphere):
    vertices, triangles = sphere
    missed = []
    for rounds in (0, 2, 6):
        surface, _ = subdivide(through_points(vertices, triangles, rounds), triangles)
        missed.append(np.linalg.norm(surface[: len(vertices)] - vertices, axis=1).max())

    assert missed[0] > 4 * missed[1] > 16 * missed[2]


def test_the_shipped_face_is_the_corpus_face(corpus_dir, tmp_path):
    source = corpus_dir / "grid_s1" / "face_mean.npz"
    main(source, tmp_path / "new.npz")

    shipped = load_mean_face()
    with np.load(tmp_path / "new.npz") as new, np.load(source) as tracked:
        np.testing.assert_allclose(new["vertices_mm"], shipped.vertices_mm, atol=0.002)
        np.testing.assert_array_equal(new["triangles"], shipped.triangles)
        missed = np.linalg.norm(
            shipped.vertices_mm[:N_SKIN] - tracked["vertices_mm"][:N_SKIN], axis=1
        )
    assert missed.mean() < 0.15
    assert missed.max() < 0.5
