"""Units and axes: what is given, and what is told where it looks otherwise."""

import numpy as np
import pytest
from lipservo_lab.scans.head_alignment import shipped_template
from lipservo_lab.scans.scan import UNITS_MM, ScanFrameError, axes_text, check_unit, scan_frame


@pytest.mark.parametrize("axes", ["x,y,z", "x,z,-y", "-y,-x,z"])
def test_axes_are_read_as_they_are_written(axes):
    assert axes_text(scan_frame("mm", axes).axes) == axes


def test_axes_say_where_each_coordinate_goes():
    point = scan_frame("cm", "x,z,-y").in_mm(np.array([[1.0, 2.0, 3.0]]))

    assert point.tolist() == [[10.0, 30.0, -20.0]]


@pytest.mark.parametrize(("unit", "axes"), [("yard", "x,y,z"), ("mm", "x,y"), ("mm", "x,x,z")])
def test_other_words_are_refused(unit, axes):
    with pytest.raises(ScanFrameError):
        scan_frame(unit, axes)


@pytest.mark.parametrize("unit", ["m", "in", "cm"])
def test_a_face_in_another_unit_is_told_with_the_option_to_give(unit):
    face = shipped_template().vertices_mm
    as_scanned = face / UNITS_MM[unit]

    with pytest.raises(ScanFrameError, match=f"--unit {unit}$"):
        check_unit(as_scanned, "mm", "s.ply")

    check_unit(face, unit, "s.ply")  # read in the right unit it is a face


def test_a_size_that_no_unit_explains_is_refused():
    with pytest.raises(ScanFrameError, match="no face"):
        check_unit(shipped_template().vertices_mm * 1000.0, "mm", "s.ply")
