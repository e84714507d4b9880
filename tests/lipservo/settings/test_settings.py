import pickle

import pytest
import yaml
from two_servo_face import FACE, load

from firmware_bridge.clock import ManualClock
from firmware_bridge.loop.targets import MemoryTargetChannel
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.runtime.servos.assembly import bridge_for
from lipservo.settings.settings import calibration_file, load_shipped_face, shipped_faces
from lipservo.settings.strict_yaml import SettingsError


def test_a_face_becomes_joints_in_the_order_of_the_yaml(tmp_path):
    jaw, lip = load(tmp_path, FACE).joints()

    assert (jaw.name, jaw.servo_id, jaw.min_deg, jaw.max_deg) == ("jaw", 3, -2.0, 25.5)
    assert (lip.name, lip.servo_id, lip.max_speed_deg_s) == ("lip", 4, 200.0)


def test_what_is_not_said_has_its_default(tmp_path):
    text = FACE.replace("calibration: face.calibration.yaml\nbus:\n  kind: simulated\n", "")
    face = load(tmp_path, text)

    assert face.bus.kind == "simulated"
    assert face.calibration is None
    assert (face.servos["jaw"].sign, face.servos["jaw"].zero_offset_deg) == (1, 0.0)


@pytest.mark.parametrize("name", shipped_faces())
def test_a_face_passes_between_processes(name):
    """Its class is made for its kind of bus, and no module has it by name."""
    face = load_shipped_face(name)

    assert pickle.loads(pickle.dumps(face)) == face


def test_an_unknown_shipped_face_is_answered_with_the_known_ones():
    with pytest.raises(SettingsError, match=r"no shipped face is called 'face_sym'; .*face_sim"):
        load_shipped_face("face_sym")


TURNED = yaml.safe_load(FACE)
TURNED["servos"] = dict(reversed(TURNED["servos"].items()))
NEEDED = [("-2", "-2.5"), ("max_deg: 30", "max_deg: 31"), ("jaw", "chin")]
NEEDED += [(FACE, yaml.safe_dump(TURNED, sort_keys=False))]
NOT_NEEDED = [("min_deg: -2", "min_deg: -2.0"), ("id: 3", "id: 30"), ("300", "299")]
NOT_NEEDED += [("sign: -1", "sign: 1"), ("test face", "other")]


@pytest.mark.parametrize(
    ("right", "changed"), NEEDED + NOT_NEEDED, ids=[new[:14] for _, new in NEEDED + NOT_NEEDED]
)
def test_the_checksum_changes_with_what_a_calibration_depends_on_alone(tmp_path, right, changed):
    before, after = load(tmp_path, FACE), load(tmp_path, FACE.replace(right, changed))

    assert (after.checksum != before.checksum) == ((right, changed) in NEEDED)


def test_a_calibration_is_found_beside_the_face(tmp_path):
    face = load(tmp_path, FACE)
    (tmp_path / "face.calibration.yaml").write_text("x: 1\n")

    assert calibration_file(face, tmp_path).read_text() == "x: 1\n"


def test_a_missing_calibration_is_named_when_it_is_needed(tmp_path):
    with pytest.raises(SettingsError, match=r"calibration 'face\.calibration\.yaml' is not in "):
        calibration_file(load(tmp_path, FACE), tmp_path)
    with pytest.raises(SettingsError, match=r"'test face' has no calibration; write `calibration:"):
        calibration_file(load(tmp_path, FACE.replace("calibration: face.calibration.yaml", "")))


def test_the_rules_of_the_gate_come_from_the_yaml(tmp_path):
    text = FACE.replace("rate_hz: 50", "rate_hz: 50\nstale: {hold_s: 0.2, limp_s: 2.0}")
    face = load(tmp_path, text)
    clock = ManualClock()
    with SimulatedBus(face.joints(), clock) as bus:
        bridge = bridge_for(face, bus, MemoryTargetChannel())
        bridge.start()
        levels = [bridge.tick(n / 50.0).stale.name for n in range(110)]

    assert [levels.index(name) for name in ("EASING", "NEUTRAL", "LIMP")] == [11, 50, 100]


@pytest.mark.parametrize("part", ["other", "tongue"])
def test_what_no_marker_shows_is_no_part_of_the_mouth(tmp_path, part):
    face = load(tmp_path, FACE.replace("  lip:\n", f"  lip:\n    part: {part}\n"))

    assert list(face.servos) == ["jaw", "lip"]
    assert list(face.mouth_servos) == ["jaw"]
