from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_model import small_model
from unpacked_head import unpack

from lipsync.face.head_motion import fit_similarity
from lipsync.face.model import load_face
from lipsync.markers import INNER_LIP, MARKERS_47, OUTER_LIP, PointLayout
from lipsync.twin.head_surface import LEFT_BROW, LEFT_EYE, RIGHT_EYE, head_surface, load_mean_face
from lipsync.twin.packed import pack, vertex_normals
from lipsync.twin.parts import jaw_displacements, jaw_modes, jaw_motion
from lipsync.twin.twin import TwinError, make_twin, skin_morphs

FACE = load_face()
SURFACE = head_surface(load_mean_face())


@pytest.fixture(scope="module")
def twin():
    return make_twin(FACE)


@pytest.fixture(scope="module")
def drawn(twin):
    """What a page reads."""
    return unpack(pack(twin))


def shown(part, coefficients=(), **targets):
    """Places of a part of what a page reads, float32."""
    amounts = {f"c{k}": amount for k, amount in enumerate(coefficients)} | targets
    places = part["places_mm"].copy()
    for name, moves in part["morphs"].items():
        places += np.float32(amounts.get(name, 0.0)) * moves
    return places


def faces(n, seed=0):
    """Coefficients as likely as in speech."""
    random = np.random.default_rng(seed)
    return random.multivariate_normal(np.zeros(FACE.n_components), FACE.covariance, n)


def test_the_head_has_about_thirty_thousand_triangles_and_three_holes():
    assert 29_000 < len(SURFACE.triangles) < 31_000
    assert sorted(len(loop) for loop in SURFACE.loops) == [64, 64, 80]


def test_markers_of_what_is_drawn_lie_where_the_model_says(drawn):
    """Up to one similarity for all frames, which lays the model's head on the twin's."""
    for coefficients in faces(20):
        markers_mm = FACE.markers_mm(coefficients[None])
        mesh = shown(drawn["skin"], coefficients)[list(FACE.layout.landmarks)].astype(np.float64)
        scale, rotation, translation = fit_similarity(markers_mm, mesh)

        laid = scale[0] * markers_mm[0] @ rotation[0].T + translation[0]

        assert np.linalg.norm(laid - mesh, axis=1).max() < 0.01
        assert scale[0] == pytest.approx(1.0, abs=0.01)


def test_morphs_say_what_the_solver_says():
    skin = skin_morphs(FACE, SURFACE)
    landmarks = list(FACE.layout.landmarks)
    coefficients = faces(1)[0]

    mesh = skin.places_mm + np.tensordot(coefficients, skin.targets_mm, axes=1)

    moves = mesh[landmarks] - SURFACE.places_mm[landmarks]
    np.testing.assert_allclose(mesh, SURFACE.places_mm + skin.weights @ moves, atol=1e-9)
    np.testing.assert_array_equal(mesh[SURFACE.anchors], SURFACE.places_mm[SURFACE.anchors])
    assert skin.weights.min() > -0.5
    assert skin.weights.max() < 1.6


def test_the_mouth_at_rest_is_closed_and_the_teeth_are_behind_it(drawn):
    skin = shown(drawn["skin"], FACE.rest)
    teeth = np.vstack([shown(drawn[f"teeth_{each}"], FACE.rest) for each in ("upper", "lower")])

    gap_mm = np.linalg.norm(skin[13] - skin[14])

    assert gap_mm == pytest.approx(FACE.lip_gap_mm(FACE.rest), rel=0.02)
    assert teeth[:, 2].max() < skin[list(INNER_LIP), 2].max() - 2.0


def test_lower_teeth_go_down_when_the_mouth_opens_and_upper_ones_stay(drawn):
    widest = max(faces(200), key=FACE.lip_gap_mm)

    lower = shown(drawn["teeth_lower"], widest) - shown(drawn["teeth_lower"], FACE.rest)

    front = drawn["teeth_lower"]["places_mm"][:, 2] > -5.0
    chin = shown(drawn["skin"], widest)[152] - shown(drawn["skin"], FACE.rest)[152]
    assert lower[front, 1].mean() == pytest.approx(chin[1], rel=0.35)
    assert drawn["teeth_upper"]["morphs"] == {}


@settings(max_examples=30, deadline=None)
@given(
    motion=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    seed=st.integers(0, 1000),
)
def test_a_jaw_that_moves_is_found_again(motion, seed):
    random = np.random.default_rng(seed)
    chin_mm, joint_mm = random.normal(0.0, 30.0, (5, 3)), np.array([0.0, 40.0, -80.0])
    wanted = np.array([motion])

    found = jaw_motion(chin_mm, joint_mm, jaw_displacements(chin_mm, joint_mm, wanted))

    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_an_opening_jaw_turns_about_its_joint():
    chin_mm, joint_mm = np.array([[0.0, -128.0, -9.0]]), np.array([0.0, -30.0, -77.0])

    (down,) = 0.01 * jaw_modes(chin_mm, joint_mm)[0]

    np.testing.assert_allclose(down, 0.01 * np.array([0.0, -68.0, -98.0]))
    assert down @ (chin_mm[0] - joint_mm) == pytest.approx(0.0)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_lid_shuts_and_passes_over_the_eyeball(twin, drawn, side):
    rim = SURFACE.loop_from(*(LEFT_EYE if side == "left" else RIGHT_EYE)[:2])
    (eye,) = (each for each in twin.eyes if each.side == side)
    half = len(rim) // 2
    for shut in np.linspace(0.0, 1.0, 9):
        targets = {f"lid_{side}": shut, f"lid_{side}_over": shut * (1 - shut)}
        edge = shown(drawn["skin"], FACE.rest, **targets)[rim].astype(np.float64)
        off = np.linalg.norm(edge - eye.centre_mm, axis=1) - eye.radius_mm
        assert off.min() > 0.0

    upper, lower = edge[: half + 1], np.vstack([edge[half:], edge[:1]])[::-1]
    assert np.linalg.norm(upper - lower, axis=1).max() < 0.5


def test_a_blink_a_brow_and_a_smile_move_what_they_should(drawn):
    skin = drawn["skin"]["morphs"]
    lips = list(INNER_LIP)

    assert np.abs(skin["lid_left"][lips]).max() < 0.1
    assert np.abs(skin["lid_left"][list(RIGHT_EYE)]).max() < 0.1
    assert (skin["brow"][list(LEFT_BROW[0]), 1] > 3.0).all()
    assert np.abs(skin["brow"][lips]).max() < 0.1
    for corner, outwards in ((61, -1.0), (291, 1.0)):
        assert skin["smile"][corner] @ (outwards, 0.0, 0.0) > 3.0
        assert skin["smile"][corner, 1] > 3.0
    np.testing.assert_array_equal(skin["smile"][SURFACE.places_mm[:, 2] < -100.0], 0.0)


def test_a_tucked_lower_lip_goes_behind_the_upper_teeth_and_the_upper_lip_shows_them(drawn):
    upper, lower = INNER_LIP[5], INNER_LIP[15]
    places_mm = shown(drawn["skin"], FACE.rest, lip_tuck=1.0).astype(np.float64)
    teeth_mm = drawn["teeth_upper"]["places_mm"]
    front_mm = teeth_mm[np.abs(teeth_mm[:, 0]) < 8.0]

    assert places_mm[lower, 2] < front_mm[:, 2].max()
    assert places_mm[upper, 1] - front_mm[:, 1].min() > 2.0
    outer_mm = places_mm[[OUTER_LIP[15]]] - shown(drawn["skin"], FACE.rest)[[OUTER_LIP[15]]]
    assert outer_mm[0, 1] > 3.0  # rolled in: its outer edge rises more than its inner one
    corners = drawn["skin"]["morphs"]["lip_tuck"][[INNER_LIP[0], INNER_LIP[10]]]
    assert np.abs(corners).max() < 1e-3


#: The jaw drops by so much in TH, and in L: its front teeth, in films on a stage.
DROPS_MM = {"tongue_dental": 2.4, "tongue_alveolar": 5.7}


def tongue_mm(drawn, target, amount=1.0):
    """Places of the tongue with its tip raised, and of all upper and lower front teeth, mm."""
    jaw = drawn["teeth_lower"]["morphs"]["c0"][:, 1]
    coefficients = FACE.rest.copy()
    coefficients[0] -= DROPS_MM[target] / jaw.mean()
    parts = [shown(drawn[n], coefficients) for n in ("teeth_upper", "teeth_lower")]
    front = [each[np.abs(each[:, 0]) < 8.0] for each in parts]
    return shown(drawn["tongue"], coefficients, **{target: amount}), *front


def test_for_th_the_tip_of_the_tongue_is_between_the_teeth_and_for_l_behind_the_upper_ones(drawn):
    dental, upper, lower = tongue_mm(drawn, "tongue_dental")
    tip = dental[dental[:, 2].argmax()]
    assert tip[2] > upper[:, 2].max()
    assert lower[:, 1].max() < tip[1] < upper[:, 1].min()

    alveolar, upper, _ = tongue_mm(drawn, "tongue_alveolar")
    tip = alveolar[alveolar[:, 2].argmax()]
    assert tip[2] < upper[:, 2].max() - 5.0  # so thick are the teeth
    assert tip[1] > upper[:, 1].min()


def test_a_tongue_at_rest_lies_behind_the_lower_teeth(drawn):
    places, teeth = (shown(drawn[name], FACE.rest) for name in ("tongue", "teeth_lower"))
    assert places[:, 1].max() < teeth[:, 1].max()
    assert places[:, 2].max() < teeth[:, 2].max()


@pytest.mark.parametrize("target", DROPS_MM)
def test_no_triangle_of_a_tongue_that_rises_turns_over(drawn, target):
    def ways(amount):
        corners = tongue_mm(drawn, target, amount)[0][drawn["tongue"]["triangles"]]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    for amount in (0.25, 0.5, 0.75, 1.0):
        assert (np.sum(ways(amount) * ways(amount - 0.25), axis=1) >= -1e-9).all()


def test_each_part_of_the_head_is_whole(twin):
    for part in twin.parts:
        assert np.isfinite(part.places_mm).all(), part.name
        assert part.triangles.max() < len(part.places_mm), part.name
        assert ((part.colours >= 0.0) & (part.colours <= 1.0)).all(), part.name
        for name, moves in part.morphs.items():
            assert moves.shape == part.places_mm.shape, (part.name, name)


def test_what_is_packed_is_what_is_unpacked(twin, drawn):
    for part in twin.parts:
        read = drawn[part.name]
        np.testing.assert_allclose(read["places_mm"], part.places_mm, atol=1e-4)
        np.testing.assert_array_equal(read["triangles"], part.triangles)
        assert list(read["morphs"]) == list(part.morphs)
        for name, moves in part.morphs.items():
            step = np.abs(moves).max() / 32767
            np.testing.assert_allclose(read["morphs"][name], moves, atol=0.51 * step + 1e-9)


def test_normals_are_those_of_another_library():
    trimesh = pytest.importorskip("trimesh")
    places, triangles = SURFACE.places_mm, SURFACE.triangles
    mesh = trimesh.Trimesh(places, triangles, process=False)
    expected = trimesh.geometry.mean_vertex_normals(
        len(places), triangles, mesh.face_normals * mesh.area_faces[:, None]
    )

    np.testing.assert_allclose(vertex_normals(places, triangles), expected, atol=1e-6)


def test_the_surface_looks_outwards_and_hangs_together():
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(SURFACE.places_mm, SURFACE.triangles, process=False)

    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0
    assert mesh.body_count == 1
    assert mesh.euler_number == 2 - len(SURFACE.loops)


def test_another_speakers_mouth_is_laid_on_the_same_head():
    other = small_model()
    skin = skin_morphs(other, SURFACE)
    landmarks = list(other.layout.landmarks)

    mesh = skin.places_mm + np.tensordot(other.rest, skin.targets_mm, axes=1)

    assert np.abs(mesh[landmarks] - SURFACE.places_mm[landmarks]).max() < 15.0
    np.testing.assert_array_equal(mesh[SURFACE.anchors], SURFACE.places_mm[SURFACE.anchors])


def test_points_that_are_numbered_otherwise_are_refused():
    groups = tuple((name, tuple(n + 1000 for n in of)) for name, of in MARKERS_47.groups)
    elsewhere = PointLayout("elsewhere", groups, (1013, 1014))
    with pytest.raises(TwinError, match="elsewhere"):
        make_twin(replace(FACE, layout=elsewhere))
