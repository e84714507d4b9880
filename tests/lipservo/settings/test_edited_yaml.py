"""Numbers in a face YAML, the offset of a loudspeaker for one: only what belongs to it changes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from two_servo_face import FACE

from lipservo.settings.edited_yaml import edited
from lipservo.settings.settings import parse_face
from lipsync.errors import UserError


def store_output_offset(path, device, offset_ms):
    edited(path, {("sound", "output_offset_ms", device): offset_ms}).write()


DEVICE = 'USB Audio: - "loud" #1'

#: What stands under `sound:` already, and what is to stand there.
CASES = {
    "nothing": ("", {DEVICE: 250.0}),
    "no line end": ("stale: {hold_s: 0.2} # last", {DEVICE: 250.0}),
    "only devices": ("sound: # here\n  output: USB # it\n", {DEVICE: 250.0}),
    "another device": (
        "sound:\n    output_offset_ms: # found\n        HDMI: 80.5 # by ear\n    input: x\n",
        {"HDMI": 80.5, DEVICE: 250.0},
    ),
    "the same device": (
        f"sound:\n  output_offset_ms:\n    '{DEVICE}': -3   # old\n    HDMI: 1\n",
        {"HDMI": 1.0, DEVICE: 250.0},
    ),
    "in one line": ("sound: {output: USB} # short\n", {DEVICE: 250.0}),
    "empty": ("sound: {}\n", {DEVICE: 250.0}),
    "offsets in one line": (
        "sound:\n  output_offset_ms: {HDMI: 3}\n",
        {"HDMI": 3.0, DEVICE: 250.0},
    ),
}


@pytest.mark.parametrize("line_end", ["\n", "\r\n"], ids=["unix", "windows"])
@pytest.mark.parametrize(("section", "offsets_ms"), CASES.values(), ids=CASES)
def test_the_offset_is_stored_and_the_rest_stays(tmp_path, section, offsets_ms, line_end):
    text = f"# my face\n{FACE.strip()}\n{section}".replace("\n", line_end)
    path = tmp_path / "face.yaml"
    path.write_bytes(text.encode())
    before = parse_face(text, "face.yaml")
    store_output_offset(path, DEVICE, 250.0)
    changed = path.read_bytes().decode()
    after = parse_face(changed, "face.yaml")

    assert dict(after.sound.output_offset_ms) == offsets_ms
    assert after.sound.output == before.sound.output
    assert after.model_copy(update={"sound": before.sound}) == before
    kept = iter(changed)
    lost = [each for each in text.replace("-3 ", "") if each not in kept]
    assert lost == [], "everything that stood there stands there, in order"
    assert changed.count("\r\n") == (changed.count("\n") if line_end == "\r\n" else 0)


ONE_LINE = (
    "{name: one, rate_hz: 50, servos: {jaw: {id: 1, model: XL330-M288, positive: opens,"
    " min_deg: 0, max_deg: 20, max_speed_deg_s: 100}}}"
)


@pytest.mark.parametrize("text", [ONE_LINE, FACE + "...\n"], ids=["one line", "ended"])
def test_a_file_without_a_safe_place_is_left_alone_and_the_lines_are_told(tmp_path, text):
    path = tmp_path / "face.yaml"
    path.write_text(text)
    with pytest.raises(
        UserError, match=r'by hand: sound: /   output_offset_ms: /     "USB": 31\.5'
    ):
        store_output_offset(path, "USB", 31.5)
    assert path.read_text() == text


@given(st.text(min_size=1, max_size=20), st.floats(-500.0, 2000.0))
def test_any_name_of_a_device_is_stored_as_it_is_or_refused(tmp_path_factory, device, offset_ms):
    path = tmp_path_factory.mktemp("faces") / "face.yaml"
    path.write_text(FACE)
    try:
        store_output_offset(path, device, offset_ms)
    except UserError:
        assert path.read_text() == FACE
    else:
        (told,) = parse_face(path.read_text("utf-8"), "f").sound.output_offset_ms.items()
        assert told == (device, pytest.approx(offset_ms, rel=1e-5))
