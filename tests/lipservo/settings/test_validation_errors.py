"""Every error in a face YAML is one line: where, what, what is allowed."""

import pytest
from two_servo_face import FACE, errors_in

MODELS = "XL330-M077, XL330-M288, XC330-M288, XC330-T288, XL430-W250, XM430-W210, XM430-W350"


KEYS = (
    "name, rate_hz, servos, bus, buses, calibration, prevent, stale, tracking, motion, sound, "
    "expression, access, avatars, start_after_power_cut, eye_distance_mm"
)
STRATEGIES = "is not known here; use one of expected, animpho, priority, naive"
ORIGIN = (
    "is not an origin of a browser; write it like https://kiosk.example or http://localhost:3000, "
    "in lower case and without a path"
)


def added(line, error):
    """A further line at the top level."""
    return "rate_hz: 50", f"rate_hz: 50\n{line}", error


def offset(late_ms):
    return f"sound: {{output_offset_ms: {{USB: {late_ms}}}}}"


def value(line, wrong, error, servo="jaw"):
    """Another value in a servo's line."""
    key, _, _ = line.partition(":")
    return line, f"{key}: {wrong}", f"servos.{servo}.{key}: {error}"


@pytest.mark.parametrize(
    ("right", "wrong", "error"),
    [
        added("stale: {hold_s: 2.0}", "stale: needs hold_s < neutral_s <= limp_s, got 2, 1 and 5"),
        added("tracking: {error_deg: 0.0}", "tracking.error_deg: 0 is outside 1..360"),
        added("access: {origins: [https://a/]}", f"access.origins.0: 'https://a/' {ORIGIN}"),
        added("access: {origins: ['*']}", f"access.origins.0: '*' {ORIGIN}"),
        added("motion: {strength: 2}", "motion.strength: 2 is outside 0..1.5"),
        added("motion: {unit_share: 1.2}", "motion.unit_share: 1.2 is outside 0..1"),
        added("motion: {stage: -0.1}", "motion.stage: -0.1 is outside 0..1"),
        added("motion: {strategy: best}", f"motion.strategy: 'best' {STRATEGIES}"),
        added("motion: {style: 1}", "motion.style: unknown setting; did you mean stage?"),
        added("motion:", "motion: None is not settings of its own (`key: value` lines)"),
        added("sound: {ouput: x}", "sound.ouput: unknown setting; did you mean output?"),
        added(offset("9000"), "sound.output_offset_ms.USB: 9000 is outside -500..2000"),
        added(offset("late"), "sound.output_offset_ms.USB: 'late' is not a number"),
        added("sound: {output: ''}", "sound.output: is empty"),
        added("rates: 3", "rates: unknown setting; did you mean rate_hz?"),
        added("voice: 3", f"voice: unknown setting; known here: {KEYS}"),
        ("rate_hz: 50", "rate_hz: 29.9", "rate_hz: 29.9 is outside 30..200"),
        ("rate_hz: 50", "rate_hz: 201", "rate_hz: 201 is outside 30..200"),
        ("name: test face", "name: 3", "name: 3 is not text; put it in quotes"),
        (
            "face.calibration.yaml",
            "/etc/face.yaml",
            r"calibration: '/etc/face.yaml' does not have the form ^[\w.-]+\.yaml$",
        ),
        (
            "  kind: simulated",
            "  kind: simulated\n  speed: x",
            "bus.speed: unknown setting; known here: kind, port, baud_rate, backend",
        ),
        (
            "kind: simulated",
            "kind: serial",
            "bus.kind: bus kind 'serial' is not known here; use one of simulated, dynamixel, "
            "maestro, pca9685, feetech, or install the package that provides it (entry point "
            "lipservo.buses)",
        ),
        value("id: 3", "300", "300 is outside 0..252"),
        value("id: 3", "-1", "-1 is outside 0..252"),
        value("id: 3", '"3"', "'3' is not a whole number"),
        value("id: 3", "3.5", "3.5 is not a whole number"),
        value("id: 3", "3.0", "3.0 is not a whole number"),
        value("id: 3", "true", "True is not a whole number"),
        value("id: 3", "", "None is not a whole number"),
        ("    id: 3\n", "", "servos.jaw.id: is missing"),
        ("id: 3", "id: 4", "servos: jaw and lip both have id 4; every servo needs its own"),
        value(
            "model: XL330-M288",
            "XL330-M289",
            f"'XL330-M289' is not known here; use one of {MODELS}",
        ),
        value("positive: opens", '""', "is empty"),
        value(
            "positive: opens",
            "on",
            "True is not text; YAML reads on, off, yes and no as true and false: put it in quotes",
        ),
        ("deg: -2", "deg: 26", "servos.jaw: needs min_deg <= 0 <= max_deg, got 26 and 25.5"),
        ("deg: -2", "deg: 1", "servos.jaw: needs min_deg <= 0 <= max_deg, got 1 and 25.5"),
        value("min_deg: -2", "-181", "-181 is outside -180..180"),
        value("min_deg: -2", ".nan", "nan is not a finite number"),
        value("min_deg: -2", "-2 deg", "'-2 deg' is not a number"),
        value("min_deg: -2", "false", "False is not a number"),
        value("max_speed_deg_s: 300", "0", "0 is outside 1..2298"),
        (
            "    max_speed_deg_s: 300",
            "    max_speed_deg_s: 300\n    max_sped_deg_s: 300",
            "servos.jaw.max_sped_deg_s: unknown setting; did you mean max_speed_deg_s?",
        ),
        (
            "    id: 3\n",
            "    id: 3\n    max_current_ma: 2000\n",
            "servos.jaw: max_current_ma 2000 is more than an XL330-M288 allows (1750 mA)",
        ),
        (
            "  jaw:\n",
            "  jaw:\n    expression: {of: smile, deg_per_unit: 9, foo: 1}\n",
            "servos.jaw.expression.foo: unknown setting; known here: of, deg_per_unit",
        ),
        value("sign: -1", "2", "2 must be 1 or -1", servo="lip"),
        value("sign: -1", "true", "True is not a whole number", servo="lip"),
        ("  jaw:", "  Jaw:", "servos.Jaw: 'Jaw' does not have the form ^[a-z][a-z0-9_]*$"),
        ("  jaw:", "  3:", "servos.3: 3 is not text; put it in quotes"),
    ],
)
def test_an_error_is_explained_in_one_line(tmp_path, right, wrong, error):
    assert right in FACE

    assert errors_in(tmp_path, FACE.replace(right, wrong, 1)) == [f"face.yaml.{error}"]


def test_every_error_gets_its_own_line(tmp_path):
    text = FACE.replace("id: 3", "id: 300").replace("sign: -1", "zign: -1").replace("name", "nome")

    assert errors_in(tmp_path, text) == [
        "face.yaml.name: is missing",
        "face.yaml.servos.jaw.id: 300 is outside 0..252",
        "face.yaml.servos.lip.zign: unknown setting; did you mean sign?",
        "face.yaml.nome: unknown setting; did you mean name?",
    ]


def test_a_face_needs_at_least_one_servo(tmp_path):
    text = FACE[: FACE.index("servos:")] + "servos: {}\n"

    assert errors_in(tmp_path, text) == ["face.yaml.servos: at least one servo is needed"]


def test_an_alias_of_an_alias_of_an_alias_is_shown_short(tmp_path):
    """Nine of nine of nine, nine times over: 3 GB, were it written out."""
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9)
    )
    lines = errors_in(tmp_path, FACE.replace("name: test face", f"{bomb}name: *a8"))
    assert len("\n".join(lines)) < 4000
    assert any("is not text" in line for line in lines)


def test_a_rule_with_a_mistyped_key_or_outside_a_list_is_told(tmp_path):
    rules = FACE + "prevent:\n  - {jonts: {jaw: 1}, above: 2, because: they touch}\n"
    told = "face.yaml.prevent.0.jonts: unknown setting; did you mean joints?"
    assert told in errors_in(tmp_path, rules)
    (line,) = errors_in(tmp_path, FACE + "prevent: {joints: {jaw: 1}, above: 2, because: near}\n")
    assert line.startswith("face.yaml.prevent: ")
    assert line.endswith("is not a list: put it in [ ]")
