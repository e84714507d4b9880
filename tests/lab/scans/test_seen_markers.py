"""Named points in a file."""

import pytest
from lipservo_lab.scans.head_alignment import shipped_template
from lipservo_lab.scans.scan import ScanError, ScanFrame, scan_frame
from lipservo_lab.scans.scan_import import read_markers

TEMPLATE = shipped_template()


def test_names_and_numbers_are_those_of_the_layouts(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("scan,name,x,y,z\nf1,outer_lip_61,1,2,3\nf1,chin_18,4,5,6\nf2,152,7,8,9\n")

    seen = read_markers(path, TEMPLATE, scan_frame("cm", "x,y,z"))

    assert TEMPLATE.landmarks[seen["f1"].vertices].tolist() == [61, 18]
    assert seen["f1"].seen_mm.tolist() == [[10, 20, 30], [40, 50, 60]]
    assert TEMPLATE.landmarks[seen["f2"].vertices].tolist() == [152]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("scan,name,x,y,z\nf1,left_ear,1,2,3\n", "line 2: the template has no point 'left_ear'"),
        ("scan,name,x,y,z\nf1,chin_18,1,,3\n", "line 2: x, y and z are not three numbers"),
        ("scan,name,x,y,z\nf1,chin_18,1,2\n", "line 2: x, y and z are not three numbers"),
        ("a,b\n1,2\n", "first line must name scan,name,x,y,z"),
        ("", "first line must name"),
    ],
)
def test_what_cannot_be_read_is_told(tmp_path, text, told):
    path = tmp_path / "m.csv"
    path.write_text(text)

    with pytest.raises(ScanError, match=told):
        read_markers(path, TEMPLATE, ScanFrame())
