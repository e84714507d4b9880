"""Which points a face has: the shipped layouts, and those that a file gives."""

import json

import pytest

from lipsync.markers import (
    FACE_MESH_478,
    LAYOUTS,
    MARKERS_39,
    MARKERS_47,
    LayoutError,
    find_layout,
    layout_of,
)


def test_the_39_are_the_47_without_inner_lips_and_both_lie_in_the_face_mesh():
    assert MARKERS_47.names[:39] == MARKERS_39.names
    assert {n for n in MARKERS_47.names if n not in MARKERS_39.names} == {
        f"inner_lip_{n}" for n in (78, 82, 13, 312, 308, 317, 14, 87)
    }
    assert FACE_MESH_478.n_points == len(FACE_MESH_478.lips) + 10 + 428
    assert set(MARKERS_47.landmarks) < set(FACE_MESH_478.landmarks) == set(range(478))


def test_each_layout_knows_its_lips_and_whether_they_touch():
    assert [len(layout.lips) for layout in LAYOUTS.values()] == [12, 20, 40]
    assert [layout.has_inner_lips for layout in LAYOUTS.values()] == [False, True, True]
    for layout in LAYOUTS.values():
        gap = f"{layout.names[layout.upper_lip]} {layout.names[layout.lower_lip]}"
        outer = layout is MARKERS_39
        assert gap == ("outer_lip_0 outer_lip_17" if outer else "inner_lip_13 inner_lip_14")
        assert {layout.upper_lip, layout.lower_lip} <= set(layout.lips)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=lambda layout: layout.name)
def test_a_layout_comes_back_from_its_description(layout, tmp_path):
    path = tmp_path / "points.json"
    path.write_text(json.dumps(layout.description()))
    assert find_layout(str(path)) == layout


GOOD = {"name": "n", "groups": {"inner_lip": [13, 14], "skin": [1, 2]}, "lip_gap": [13, 14]}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"lip_gap": [13, 99]}, "landmark 99 is in no group"),
        ({"lip_gap": [13, 13]}, "lip_gap needs two different landmarks"),
        ({"lip_gap": [13]}, "lip_gap be two of them"),
        ({"groups": {"skin": [13, 14, 14]}}, "landmark 14 is listed twice"),
        ({"groups": {"skin": [13, 14, "nose"]}}, "'nose' is not a landmark number"),
        ({"groups": {"skin": [13, 14, -1]}}, "-1 is not a landmark number"),
        ({"groups": [13, 14]}, "`groups` must map names to lists of landmark numbers"),
    ],
)
def test_what_is_wrong_with_a_layout_is_said_in_one_line(change, said):
    layout_of(GOOD)
    with pytest.raises(LayoutError, match=said) as refused:
        layout_of(GOOD | change)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, r"neither a known layout \(39, 47, 478\) nor a readable file"),
        ("{", "not JSON"),
        ("[1]", "a layout must be a JSON object with name, groups, lip_gap"),
        ('{"name": "n"}', "the layout lacks groups, lip_gap"),
    ],
)
def test_a_file_that_is_no_layout_is_refused(tmp_path, content, said):
    path = tmp_path / "points.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(LayoutError, match=said):
        find_layout(str(path))


@pytest.mark.parametrize("group", ["lips", "lips_outer", "upperlip", "inner_lip"])
def test_a_group_with_lip_anywhere_in_its_name_is_lips(group):
    layout = layout_of(GOOD | {"groups": {"skin": [1, 2], group: [13, 14]}})
    assert layout.lips == (2, 3)
