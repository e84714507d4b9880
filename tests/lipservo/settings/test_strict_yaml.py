"""What a YAML file may be, and what is read in its numbers."""

import pytest
from two_servo_face import FACE, errors_in, load

from lipservo.settings.settings import load_face
from lipservo.settings.strict_yaml import SettingsError


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "face.yaml: is empty"),
        ("# nothing but a comment\n", "face.yaml: is empty"),
        ("- jaw\n- lip\n", "face.yaml: must have `key: value` lines, found a list"),
        ("jaw\n", "face.yaml: must have `key: value` lines, found 'jaw'"),
        ("name: a\nservos: {jaw: [\n", "face.yaml: not YAML at line 3: "),
        ("name: a\n\tservos: 3\n", "face.yaml: not YAML at line 2: "),
        ("name: a\nrate_hz: 3\nname: b\n", "face.yaml.name: given twice, on lines 1 and 3; "),
        ("bus: {kind: a, kind: b}\n", "face.yaml.bus.kind: given twice, on lines 1 and 1; "),
        ("name: !!python/name:os.system\n", "face.yaml: not YAML at line 1: "),
        ("name: \x07\n", "face.yaml: not YAML: unacceptable character"),
    ],
)
def test_a_file_that_is_no_mapping_is_refused(tmp_path, text, error):
    (line,) = errors_in(tmp_path, text)

    assert line.startswith(error)


def test_a_mapping_that_contains_itself_is_read_without_end_being_awaited(tmp_path):
    assert "face.yaml.loop: unknown setting" in errors_in(tmp_path, FACE + "loop: &a {b: *a}\n")[0]


def test_a_file_that_cannot_be_read_or_is_not_text_is_named(tmp_path):
    path = tmp_path / "face.yaml"
    with pytest.raises(SettingsError, match=r"face\.yaml: cannot be read: No such file"):
        load_face(path)
    path.write_bytes(b"name: \xff\xfe\n")
    with pytest.raises(SettingsError, match=r"face\.yaml: not UTF-8 text \(byte 6\)"):
        load_face(path)


@pytest.mark.parametrize("written", ["3e2", "0300", "+300", "0x12c"])
def test_numbers_are_what_a_person_reads_in_them(tmp_path, written):
    """YAML 1.2, section 10.3.2: no octal by a leading zero, and `3e2` needs no point."""
    text = FACE.replace("max_speed_deg_s: 300", f"max_speed_deg_s: {written}")
    jaw = load(tmp_path, text.replace("id: 3\n", "id: 011\n")).servos["jaw"]
    assert (jaw.max_speed_deg_s, jaw.id) == (300.0, 11)


@pytest.mark.parametrize("nested", ["[" * 5000, "{a: " * 5000, "- " * 5000])
def test_settings_nested_very_deep_are_refused_in_one_line(tmp_path, nested):
    (line,) = errors_in(tmp_path, nested)
    assert "nested too deep" in line or "not YAML" in line
