"""Which takes a folder holds."""

import pytest
from lipservo_lab.scans.scan import ScanError
from lipservo_lab.scans.takes import find_takes


def touch(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")


def test_each_folder_is_a_take_and_its_scans_are_in_order_of_their_numbers(tmp_path):
    touch(tmp_path, "a/f10.ply", "a/f9.ply", "a/notes.md", "b/1.obj", "empty/x.txt")
    touch(tmp_path, "a.wav", "a.txt", "b.TextGrid", "b.flac", "b.markers.csv")

    a, b = find_takes(tmp_path)

    assert [path.name for path in a.scans] == ["f9.ply", "f10.ply"]
    assert (a.sound.name, a.text, a.labels, a.markers) == ("a.wav", "x", None, None)
    assert (b.sound.name, b.labels.name) == ("b.flac", "b.TextGrid")
    assert b.markers.name == "b.markers.csv"


def test_a_folder_of_scans_is_one_take_and_the_neutral_scan_is_none_of_them(tmp_path):
    folder = tmp_path / "take"
    touch(folder, "1.ply", "2.PLY", "neutral.ply", "take.wav")

    (take,) = find_takes(folder, folder / "neutral.ply")

    assert (take.name, len(take.scans), take.sound.name) == ("take", 2, "take.wav")


def test_nothing_and_a_single_scan_are_no_motion(tmp_path):
    with pytest.raises(ScanError, match="holds no scan"):
        find_takes(tmp_path)
    with pytest.raises(ScanError, match="no such folder"):
        find_takes(tmp_path / "other")
    touch(tmp_path, "1.ply")
    with pytest.raises(ScanError, match="holds one scan"):
        find_takes(tmp_path)
