"""A face of hobby servos from nothing: its YAML, and what commands say that have nothing to do."""

import io
import json
from importlib import resources

import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process import lipservo, refused

from calibration.files.calibration_file import load_calibration
from firmware_bridge.bus_kinds import bus_kind
from lipservo.runtime.servos.new_face import WiredJoint, check_wiring, pulse_face_yaml
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.settings.settings import load_face

MAESTRO = ("--bus", "maestro", "--yes")
TWO = ("--bus", "lips=maestro", "--bus", "eyes=pca9685", "--yes")
SHIPPED = resources.files("lipservo.config")
JAW = ("--channel", "jaw=0:opens")


@pytest.mark.parametrize("bus", ["maestro", "pca9685"])
def test_a_face_is_written_with_narrow_limits_and_can_be_moved(tmp_path, bus):
    path = tmp_path / "mine.yaml"
    wired = ("--bus", bus, "--yes", *JAW, "--channel", "upper_lip=5:raises")
    done = lipservo("new-face", "-o", path, *wired)

    assert done.returncode == 0, done.stderr
    face = load_face(path)
    assert face.bus.kind == bus
    assert [(n, s.channel, s.positive) for n, s in face.servos.items()] == [
        ("jaw", 0, "opens"), ("upper_lip", 5, "raises"),
    ]  # fmt: skip
    for servo in face.servos.values():
        assert (servo.min_us, servo.neutral_us, servo.max_us) == (1400.0, 1500.0, 1600.0)
        assert (servo.min_deg, servo.max_deg) == (-9.0, 9.0)
    text = path.read_text()
    assert "lipservo jog --dashboard" in text
    assert text.count("#") > 15, "it explains itself"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((*MAESTRO, "--board", "nano", *JAW), "'nano' is not known here; use one of micro6, mini"),
        ((*MAESTRO, "--board", "", *JAW), "'' is not the model of a maestro"),
        ((*MAESTRO, "--board", "a: b", *JAW), "'a: b' is not the model of a maestro"),
        ((*MAESTRO, "--channel", "jaw=9:opens"), "jaw: a Maestro micro6 has channels 0 to 5"),
        ((*MAESTRO, *JAW, "--channel", "lip=0:raises"), "channel 0 belongs to jaw"),
        ((*MAESTRO, *JAW, *JAW), "joint jaw exists already"),
        ((*MAESTRO, "--channel", "jaw"), "write NAME=CHANNEL:WORD"),
        ((*MAESTRO, "--channel", "jaw=-1:opens"), "write NAME=CHANNEL:WORD"),
        ((*MAESTRO, "--channel", "jaw=0"), "add what a longer pulse does: jaw=0:opens"),
        ((*MAESTRO, "--channel", "Jaw=0:opens"), "'Jaw' is not a joint's name"),
        (MAESTRO, "no servos given; add --channel jaw=0:opens"),
        (("--bus", "pca9685", "--yes", "--board", "0x70", *JAW), "PCA9685 address 0x70 is not"),
        (("--bus", "pca9685", "--yes", "--channel", "jaw=16:opens"), "16 is outside 0..15"),
        (("--bus", "parrot", *JAW), "'parrot' is not known here; use one of simulated, dynamixel"),
        (("--bus", "dynamixel", *JAW), "--channel is not for a dynamixel bus"),
        (("--bus", "dynamixel"), "no port given; add --port"),
        ((*MAESTRO, *JAW, "--ranges", "x.json"), "--ranges is not for a maestro bus"),
        ((), "no port: give --port, or --bus KIND (maestro) if no board is plugged in"),
        (("--bus", "maestro", "--bus", "pca9685"), "--bus is given 2 times; for several"),
        ((*TWO, "--bus", "lips=maestro"), "--bus: lips is given twice"),
        ((*TWO, "--bus", "maestro"), "--bus 'maestro': write NAME=..."),
        ((*TWO, "--port", "/dev/ttyACM0"), "--port '/dev/ttyACM0': write NAME=..."),
        ((*TWO, "--board", "neck=nano"), "no --bus is so named; known: lips, eyes"),
        ((*TWO, *JAW), "'jaw=0:opens': add its bus, as lips/jaw=0:opens"),
        ((*TWO, "--channel", "neck/jaw=0:opens"), "buses of hobby servos: lips, eyes"),
        ((*TWO, "--channel", "lips/jaw=0:opens"), "no servos given; add --channel"),
        ((*TWO, *("--channel", "lips/jaw=0:opens", "--channel", "eyes/jaw=0:opens")), "jaw exists"),
        (("--bus", "lips=maestro", "--bus", "neck=dynamixel", "--yes", *JAW), "no port given"),
    ],
)
def test_bad_input_is_one_line_and_no_file(tmp_path, arguments, words):
    notes = arguments[1:2] == ("lips=maestro",)  # each bus is named as its turn comes
    assert words in refused("new-face", "-o", tmp_path / "mine.yaml", *arguments, notes=notes)
    assert list(tmp_path.iterdir()) == []


def test_a_board_or_channel_that_is_not_there_is_asked_for_again_and_no_answer_is_lost(
    tmp_path, monkeypatch
):
    path = tmp_path / "mine.yaml"
    answers = "micro7\nmini12\njaw=9:opens\nlip=12:raises\nlip=3:raises\n\n"
    monkeypatch.setattr("sys.stdin", io.StringIO(answers))
    done = lipservo("new-face", "-o", path, "--bus", "maestro")

    assert done.returncode == 0, done.stderr
    assert "'micro7' is not known here" in done.stderr
    assert "lip: a Maestro mini12 has channels 0 to 11" in done.stderr
    face = load_face(path)
    assert face.bus.model == "mini12"
    assert {name: servo.channel for name, servo in face.servos.items()} == {"jaw": 9, "lip": 3}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--ranges", "x.json", "--yes"), "--ranges, --yes: not with --page"),
        (("--board", "micro6"), "--board: not with --page"),
        (("--baud-rate", "57600"), "--baud-rate: not with --page"),
        (JAW, "--channel: not with --page"),
        (("--bus", "feetech"), "no port: give --port, where the servos of --bus feetech are"),
        (("--bus", "parrot"), "'parrot' is not known here"),
        (("--bus", "maestro", "--sim", "pty"), "not together with --port or --bus"),
    ],
)
def test_what_the_page_does_not_take_is_refused(tmp_path, arguments, words):
    assert words in refused("new-face", "--page", "-o", tmp_path / "mine.yaml", *arguments)


def test_the_page_leaves_the_bus_of_a_yaml_as_it_is(face):
    said = refused("new-face", "--page", "-o", face, "--bus", "pca9685")
    assert "names its bus already; leave --bus out" in said


def test_a_face_on_two_buses_is_written_and_can_be_moved(tmp_path):
    path = tmp_path / "mine.yaml"
    wired = ("--channel", "lips/jaw=0:opens", "--channel", "eyes/lids=3:opens")
    where = ("--port", "lips=/dev/ttyACM0", "--board", "lips=mini12")
    done = lipservo("new-face", "-o", path, *TWO, *where, *wired)

    assert done.returncode == 0, done.stderr
    face = load_face(path)
    assert [(name, bus.kind, bus.port) for name, bus in face.buses.items()] == [
        ("lips", "maestro", "/dev/ttyACM0"), ("eyes", "pca9685", None),
    ]  # fmt: skip
    assert face.buses["lips"].model == "mini12"
    assert face.bus_of == ("lips", "eyes")
    assert (face.servos["lids"].channel, face.servos["lids"].min_us) == (3, 1400.0)


@given(
    st.text(min_size=1, max_size=30),
    st.text(st.characters(codec="utf-8"), min_size=1, max_size=30).filter(str.strip),
    st.sampled_from(["/dev/ttyACM0", "/dev/a: b", "yes", "#", 'x"y', None]),
)
def test_whatever_words_a_person_uses_the_yaml_says_them(name, positive, port):
    kind = bus_kind("maestro")
    joints = [WiredJoint("jaw", 0, positive)]
    face = check_wiring(pulse_face_yaml(name, kind, port, "micro6", joints), "mine.yaml")

    assert face.servos["jaw"].positive == positive
    assert face.bus.port == port
    assert face.name == name.encode(errors="replace").decode()


@pytest.fixture
def face(tmp_path):
    path = tmp_path / "mine.yaml"
    assert lipservo("new-face", "-o", path, *MAESTRO, *JAW).returncode == 0
    return path


def test_there_is_nothing_to_set_up_and_the_way_to_the_limits_is_named(face):
    done = lipservo("setup-servos", "--config", face)

    assert done.returncode == 0
    assert done.stdout.startswith("nothing to set up: servos on a maestro bus keep no settings")
    assert "lipservo jog JOINT" in done.stdout
    assert "no joint 'tongue'" in lipservo("setup-servos", "tongue", "--config", face).stderr
    told = json.loads(lipservo("setup-servos", "--config", face, "--json", "--dry-run").stdout)
    assert told == {"dry_run": True, "complete": True, "error": "", "servos": []}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--limp",), "cannot say where they stand: find their limits with `lipservo jog JOINT`"),
        ((), "no joint given; name one, or give --dashboard"),
        (("tongue",), "this face has no joint 'tongue'; it has jaw"),
        (("tongue", "3"), "this face has no joint 'tongue'; it has jaw"),
        (("jaw", "20"), "jaw: 20 deg is outside -9..9"),
        (("jaw", "nan"), "jaw: nan deg is outside -9..9"),
        (("jaw", "2", "--limp"), "DEG needs JOINT, and no"),
        (("--open",), "--open needs --dashboard"),
    ],
)
def test_what_jog_cannot_do_is_one_line(face, arguments, words):
    assert words in refused("jog", *arguments, "--config", face, notes=True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("neck_yaw",), "no port: "),
        (("jaw",), "lipservo: jaw: these servos cannot say where they stand"),
        ((), "lipservo: jaw, "),
    ],
)
def test_of_a_mixed_face_joints_are_turned_by_hand_that_say_where_they_stand(arguments, words):
    assert words in refused("jog", *arguments, "--limp", "--config", "face_head_mixed")


def test_a_move_is_told_in_degrees_and_as_a_pulse(face):
    done = lipservo("jog", "jaw", "2", "--config", face, "--hold-s", "0")

    assert done.stdout == "jaw was sent to 2.0 deg (1522 us)\n", done.stderr


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ((), "the mouth's servos report no position, so they cannot measure their lag: film one"),
        (("jaw=x",), "--lag-ms jaw=x: needs JOINT=MS with 0 to 500 ms"),
        (("jaw=501",), "needs JOINT=MS with 0 to 500 ms"),
        (("jaw=nan",), "needs JOINT=MS with 0 to 500 ms"),
        (("lip=9",), "no such joint; use one of jaw"),
        (("jaw=9", "jaw=8"), "jaw is given twice"),
        (("jaw=72.5",), ""),
    ],
)
def test_lags_of_servos_without_an_encoder_are_typed(tmp_path, typed, words):
    path = tmp_path / "jaw.calibration.yaml"
    shipped = (SHIPPED / "face_jaw.calibration.yaml").read_text()
    path.write_text(shipped)
    options = [part for each in typed for part in ("--lag-ms", each)]
    done = lipservo("calibrate", "lags", path, "--config", "face_jaw_maestro", *options)

    assert words in done.stderr
    assert done.returncode == (1 if words else 0)
    if words:
        assert path.read_text() == shipped
    else:
        assert load_calibration(path).following.lag_s.tolist() == [0.0725]
        assert "72 ms late" in done.stdout


def test_the_doctor_says_which_lags_no_servo_confirms_and_which_are_not_known(tmp_path):
    without, path = tmp_path / "face_jaw.calibration.yaml", tmp_path / "jaw.yaml"
    without.write_text((SHIPPED / "face_jaw.calibration.yaml").read_text())
    path.write_text((SHIPPED / "face_jaw_maestro.yaml").read_text())

    def said():
        with simulated_port(["--config", str(path)]) as port:
            return lipservo("doctor", "--config", path, "--port", port).stdout

    assert "late by the calibration, which these servos cannot confirm: jaw" in said()
    without.unlink()
    assert lipservo("calibrate", "fit", "--config", path, "-o", without).returncode == 0
    assert "how late these servos are is not known, and lips are late by as much: jaw" in said()
    assert "lipservo calibrate lags FILE --lag-ms jaw=60" in said()


def test_a_face_of_hobby_servos_gets_a_first_calibration_and_no_lags_that_nobody_measured(face):
    path = face.parent / "mine.calibration.yaml"
    done = lipservo("calibrate", "fit", "--config", face, "-o", path)

    assert done.returncode == 0, done.stderr
    assert "lag_s" not in path.read_text()
