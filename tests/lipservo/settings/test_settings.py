import pytest
import yaml

from firmware_bridge.clock import ManualClock
from firmware_bridge.loop.channel import MemoryTargetChannel
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.face.servos import bridge_for
from lipservo.settings.settings import (
    SettingsError,
    calibration_file,
    load_face,
    load_shipped_face,
    shipped_faces,
)

FACE = """\
name: test face
rate_hz: 50
calibration: face.calibration.yaml
bus:
  kind: simulated
servos:
  jaw:
    id: 3
    model: XL330-M288
    positive: opens
    min_deg: -2
    max_deg: 25.5
    max_speed_deg_s: 300
  lip:
    id: 4
    model: XM430-W350
    positive: raises
    min_deg: -30
    max_deg: 30
    max_speed_deg_s: 200
    sign: -1
    zero_offset_deg: 1.5
"""


def load(tmp_path, text):
    path = tmp_path / "face.yaml"
    path.write_text(text, encoding="utf-8")
    return load_face(path)


def mistakes_in(tmp_path, text):
    with pytest.raises(SettingsError) as caught:
        load(tmp_path, text)
    return str(caught.value).splitlines()


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
def test_every_shipped_face_loads(name):
    assert load_shipped_face(name).joints()


def test_the_simulated_face_is_a_mouth_of_ten_servos():
    face = load_shipped_face("face_sim")

    assert list(face.servos) == [
        "jaw",
        "upper_lip_left",
        "upper_lip_right",
        "lower_lip_left",
        "lower_lip_right",
        "corner_left_out",
        "corner_left_up",
        "corner_right_out",
        "corner_right_up",
        "lip_protrusion",
    ]


def test_an_unknown_shipped_face_is_answered_with_the_known_ones():
    with pytest.raises(SettingsError, match=r"no face 'face_sym' is shipped; .*face_sim"):
        load_shipped_face("face_sym")


MODELS = "XL330-M077, XL330-M288, XC330-M288, XC330-T288, XL430-W250, XM430-W210, XM430-W350"


@pytest.mark.parametrize(
    ("right", "wrong", "mistake"),
    [
        (
            "rate_hz: 50",
            "rate_hz: 50\nstale: {hold_s: 2.0}",
            "stale: needs hold_s < neutral_s <= limp_s, got 2, 1 and 5",
        ),
        (
            "rate_hz: 50",
            "rate_hz: 50\ntracking: {error_deg: 0.0}",
            "tracking.error_deg: 0 is outside 1..360",
        ),
        (
            "    id: 3\n",
            "    id: 3\n    max_current_ma: 2000\n",
            "servos.jaw: max_current_ma 2000 is more than an XL330-M288 takes, 1750",
        ),
        ("id: 3", "id: 300", "servos.jaw.id: 300 is outside 0..252"),
        ("id: 3", "id: -1", "servos.jaw.id: -1 is outside 0..252"),
        ("id: 3", 'id: "3"', "servos.jaw.id: '3' is not a whole number"),
        ("id: 3", "id: 3.5", "servos.jaw.id: 3.5 is not a whole number"),
        ("id: 3", "id: 3.0", "servos.jaw.id: 3.0 is not a whole number"),
        ("id: 3", "id: true", "servos.jaw.id: True is not a whole number"),
        ("id: 3", "id:", "servos.jaw.id: None is not a whole number"),
        ("    id: 3\n", "", "servos.jaw.id: is missing"),
        (
            "id: 3",
            "id: 4",
            "servos: jaw and lip both have id 4; every servo needs its own",
        ),
        (
            "XL330-M288",
            "XL330-M289",
            f"servos.jaw.model: 'XL330-M289' is not known here; use one of {MODELS}",
        ),
        ("positive: opens", 'positive: ""', "servos.jaw.positive: is empty"),
        ("positive: opens", "positive: on", "servos.jaw.positive: True is not text"),
        (
            "min_deg: -2",
            "min_deg: 26",
            "servos.jaw: needs min_deg <= 0 <= max_deg, got 26 and 25.5",
        ),
        ("min_deg: -2", "min_deg: 1", "servos.jaw: needs min_deg <= 0 <= max_deg, got 1 and 25.5"),
        ("min_deg: -2", "min_deg: -181", "servos.jaw.min_deg: -181 is outside -180..180"),
        ("min_deg: -2", "min_deg: .nan", "servos.jaw.min_deg: nan is not a finite number"),
        ("min_deg: -2", "min_deg: -2 deg", "servos.jaw.min_deg: '-2 deg' is not a number"),
        ("min_deg: -2", "min_deg: false", "servos.jaw.min_deg: False is not a number"),
        (
            "max_speed_deg_s: 300",
            "max_speed_deg_s: 0",
            "servos.jaw.max_speed_deg_s: 0 is outside 1..2298",
        ),
        (
            "    max_speed_deg_s: 300",
            "    max_speed_deg_s: 300\n    max_sped_deg_s: 300",
            "servos.jaw.max_sped_deg_s: unknown setting; did you mean max_speed_deg_s?",
        ),
        ("sign: -1", "sign: 2", "servos.lip.sign: 2 is neither 1 nor -1"),
        ("sign: -1", "sign: true", "servos.lip.sign: True is not a whole number"),
        (
            "  kind: simulated",
            "  kind: simulated\n  speed: x",
            "bus.speed: unknown setting; known here: kind, port, baud_rate, backend",
        ),
        (
            "kind: simulated",
            "kind: serial",
            "bus.kind: 'serial' is not known here; use one of simulated, dynamixel",
        ),
        ("rate_hz: 50", "rate_hz: 29.9", "rate_hz: 29.9 is outside 30..200"),
        ("rate_hz: 50", "rate_hz: 201", "rate_hz: 201 is outside 30..200"),
        ("rate_hz: 50", "rate_hz: 50\nrates: 3", "rates: unknown setting; did you mean rate_hz?"),
        (
            "rate_hz: 50",
            "rate_hz: 50\nvoice: 3",
            "voice: unknown setting; known here: "
            "name, rate_hz, servos, bus, calibration, prevent, stale, tracking",
        ),
        ("name: test face", "name: 3", "name: 3 is not text"),
        ("  jaw:", "  Jaw:", "servos.Jaw: 'Jaw' does not have the form ^[a-z][a-z0-9_]*$"),
        ("  jaw:", "  3:", "servos.3: 3 is not text"),
        (
            "face.calibration.yaml",
            "/etc/face.yaml",
            r"calibration: '/etc/face.yaml' does not have the form ^[\w.-]+\.yaml$",
        ),
    ],
)
def test_a_mistake_is_explained_in_one_line(tmp_path, right, wrong, mistake):
    assert right in FACE

    assert mistakes_in(tmp_path, FACE.replace(right, wrong, 1)) == [f"face.yaml.{mistake}"]


def test_every_mistake_gets_its_own_line(tmp_path):
    text = FACE.replace("id: 3", "id: 300").replace("sign: -1", "zign: -1").replace("name", "nome")

    assert mistakes_in(tmp_path, text) == [
        "face.yaml.name: is missing",
        "face.yaml.servos.jaw.id: 300 is outside 0..252",
        "face.yaml.servos.lip.zign: unknown setting; did you mean sign?",
        "face.yaml.nome: unknown setting; did you mean name?",
    ]


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("", "face.yaml: is empty"),
        ("# nothing but a comment\n", "face.yaml: is empty"),
        ("- jaw\n- lip\n", "face.yaml: needs settings as `key: value`, found a list"),
        ("jaw\n", "face.yaml: needs settings as `key: value`, found 'jaw'"),
        ("name: a\nservos: {jaw: [\n", "face.yaml: not YAML at line 3: "),
        ("name: a\n\tservos: 3\n", "face.yaml: not YAML at line 2: "),
        ("name: a\nrate_hz: 3\nname: b\n", "face.yaml.name: given twice, on lines 1 and 3; "),
        ("bus: {kind: a, kind: b}\n", "face.yaml.bus.kind: given twice, on lines 1 and 1; "),
        ("name: !!python/name:os.system\n", "face.yaml: not YAML at line 1: "),
        ("name: \x07\n", "face.yaml: not YAML: unacceptable character"),
    ],
)
def test_a_file_that_is_no_mapping_is_refused(tmp_path, text, mistake):
    (line,) = mistakes_in(tmp_path, text)

    assert line.startswith(mistake)


def test_a_face_needs_at_least_one_servo(tmp_path):
    text = FACE[: FACE.index("servos:")] + "servos: {}\n"

    assert mistakes_in(tmp_path, text) == ["face.yaml.servos: needs at least one servo"]


def test_a_mapping_that_contains_itself_is_read_without_end_being_awaited(tmp_path):
    assert (
        "face.yaml.loop: unknown setting" in mistakes_in(tmp_path, FACE + "loop: &a {b: *a}\n")[0]
    )


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"nowhere\.yaml: cannot be read: No such file"):
        load_face(tmp_path / "nowhere.yaml")


def test_a_file_that_is_not_text_is_named(tmp_path):
    path = tmp_path / "face.yaml"
    path.write_bytes(b"name: \xff\xfe\n")

    with pytest.raises(SettingsError, match=r"face\.yaml: not UTF-8 text \(byte 6\)"):
        load_face(path)


@pytest.mark.parametrize(
    ("right", "changed"),
    [("-2", "-2.5"), ("max_deg: 30", "max_deg: 31"), ("jaw", "chin")],
)
def test_the_checksum_changes_with_what_a_calibration_depends_on(tmp_path, right, changed):
    assert load(tmp_path, FACE.replace(right, changed)).checksum != load(tmp_path, FACE).checksum


def test_the_checksum_changes_with_the_order_of_the_servos(tmp_path):
    content = yaml.safe_load(FACE)
    content["servos"] = dict(reversed(content["servos"].items()))
    turned = yaml.safe_dump(content, sort_keys=False)

    assert load(tmp_path, turned).checksum != load(tmp_path, FACE).checksum


@pytest.mark.parametrize(
    ("right", "changed"),
    [
        ("min_deg: -2", "min_deg: -2.0"),
        ("id: 3", "id: 30"),
        ("300", "299"),
        ("sign: -1", "sign: 1"),
        ("test face", "other"),
    ],
)
def test_the_checksum_ignores_what_a_calibration_does_not_depend_on(tmp_path, right, changed):
    assert load(tmp_path, FACE.replace(right, changed)).checksum == load(tmp_path, FACE).checksum


def test_a_calibration_is_found_beside_the_face(tmp_path):
    face = load(tmp_path, FACE)
    (tmp_path / "face.calibration.yaml").write_text("x: 1\n")

    assert calibration_file(face, tmp_path).read_text() == "x: 1\n"


def test_a_missing_calibration_is_named_when_it_is_needed(tmp_path):
    with pytest.raises(SettingsError, match=r"no calibration 'face\.calibration\.yaml' in "):
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


@pytest.mark.parametrize(
    ("written", "meant"), [("3e2", 300.0), ("0300", 300.0), ("+300", 300.0), ("0x12c", 300.0)]
)
def test_numbers_are_what_a_person_reads_in_them(tmp_path, written, meant):
    """YAML 1.2, section 10.3.2: no octal by a leading zero, and `3e2` needs no point."""
    face = load(tmp_path, FACE.replace("max_speed_deg_s: 300", f"max_speed_deg_s: {written}"))
    assert face.servos["jaw"].max_speed_deg_s == meant


def test_a_leading_zero_makes_no_octal_id(tmp_path):
    assert load(tmp_path, FACE.replace("id: 3\n", "id: 011\n")).servos["jaw"].id == 11


@pytest.mark.parametrize("nested", ["[" * 5000, "{a: " * 5000, "- " * 5000])
def test_settings_nested_very_deep_are_refused_in_one_line(tmp_path, nested):
    (line,) = mistakes_in(tmp_path, nested)
    assert "nested too deep" in line or "not YAML" in line


def test_an_alias_of_an_alias_of_an_alias_is_shown_short(tmp_path):
    """Nine of nine of nine, nine times over: 3 GB, were it written out."""
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9)
    )
    lines = mistakes_in(tmp_path, FACE.replace("name: test face", f"{bomb}name: *a8"))
    assert len("\n".join(lines)) < 4000
    assert any("is not text" in line for line in lines)


def test_a_mistyped_key_of_a_rule_is_told(tmp_path):
    rules = FACE + "prevent:\n  - {jonts: {jaw: 1}, above: 2, because: they touch}\n"
    lines = mistakes_in(tmp_path, rules)
    assert "face.yaml.prevent.0.jonts: unknown setting; did you mean joints?" in lines
