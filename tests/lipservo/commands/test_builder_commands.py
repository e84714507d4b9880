"""The commands of a builder's first hour, as they are typed, on simulated servos behind a pty."""

import json
import os
import subprocess
import sys
from contextlib import closing

import in_process
import pytest
from hobby_bus import on_maestro_yaml, on_pca9685
from speech import clip_start

from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.serial_servos.serial_transport import open_port
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.settings.settings import load_face, load_shipped_face

# Real processes in real time.
pytestmark = pytest.mark.slow


def lipservo(*arguments, **options):
    command = [sys.executable, "-m", "lipservo", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=180, **options)


@pytest.fixture(scope="module")
def port():
    with simulated_port(["--config", "face_sim", "--on-time"]) as port:
        yield port


def test_doctor_finds_a_healthy_face_healthy(port):
    done = lipservo("doctor", "--port", port)

    assert done.returncode == 0, done.stdout + done.stderr
    assert "10 servos at 1,000,000 baud can do 30 Hz" in done.stdout
    for said in ("measured now", "s a second at 30 Hz", "a page with one viewer takes about"):
        assert said in done.stdout


def test_jog_and_neutral_move_through_the_gate(port):
    done = lipservo("jog", "jaw", "5", "--port", port, "--hold-s", "0.3")
    assert done.stdout.strip() == "jaw stands at 5.0 deg, sent to 5.0 deg", done.stderr
    done = lipservo("calibrate", "neutral", "--port", port)
    assert "jaw stands at 0.0 deg" in done.stdout, done.stderr


@pytest.fixture
def jammed(tmp_path):
    """The port of a jaw that nothing moves."""
    script = tmp_path / "faults.yaml"
    script.write_text("faults: [{kind: jam, servos: [0], at_s: 0, amount: 1.0}]")
    with simulated_port(["--config", "face_jaw", "--on-time", "--faults", str(script)]) as port:
        yield port


def test_a_jammed_servo_is_said_to_have_missed_its_goal(jammed):
    at = ("--config", "face_jaw", "--port", jammed)
    small = lipservo("jog", "jaw", "2", "--hold-s", "0", *at)  # as near as a weak servo may be
    missed = lipservo("jog", "jaw", "10", "--hold-s", "0", *at)
    assert (small.returncode, small.stdout) == (0, "jaw stands at 0.0 deg, sent to 2.0 deg\n")
    assert (missed.returncode, missed.stdout) == (1, "jaw stands at 0.0 deg, sent to 10.0 deg\n")
    assert "jaw is 10.0 deg off its goal: is it blocked, or too weak?" in missed.stderr
    assert lipservo("calibrate", "neutral", *at).returncode == 0  # it is there


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["doctor", "--port", "/dev/ttyUSB77"], "/dev/ttyUSB77: no such port"),
        (["doctor"], "no port: give --port"),
        (["run", "--port", "/dev/ttyUSB77"], "/dev/ttyUSB77: no such port"),
        (["run", "--sim", "usb"], "--sim only accepts `pty`"),
        (["sim-bus", "--model", "AX-12"], "model 'AX-12' is not known"),
        (["sim-bus", "--baud-rate", "12345"], "no baud rate 12345"),
        (["setup-servos", "tongue", "--port", "x"], "no joint 'tongue'"),
    ],
)
def test_bad_input_ends_in_one_clear_line(arguments, said):
    done = in_process.lipservo(*arguments)

    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert said in line


def test_servos_at_another_rate_do_not_answer_and_the_doctor_is_named():
    with simulated_port(["--config", "face_sim", "--baud-rate", "57600"]) as port:
        done = lipservo("run", "--port", port, "--json")

    assert done.returncode == 1
    assert "servo 'jaw' (id 11) does not answer" in done.stderr
    assert "lipservo doctor" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("command", ["run", "daemon"])
def test_servos_that_differ_from_the_yaml_are_refused_before_anything_moves(tmp_path, command):
    script = tmp_path / "faults.yaml"
    script.write_text("faults: [{kind: limits_drift, servos: [0], at_s: 0.0, amount: 2100}]")
    with simulated_port(["--config", "face_sim", "--on-time", "--faults", str(script)]) as port:
        control = [] if command == "run" else ["--control", tmp_path / "control.sock"]
        done = lipservo(command, "--port", port, *control)

    assert done.returncode == 1
    assert "servo 'jaw' (id 11) has limits" in done.stderr
    assert "setup-servos" in done.stderr
    assert "`lipservo doctor` shows every difference" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_face_whose_yaml_has_no_port_is_set_up_at_the_one_given():
    with simulated_port(["--kind", "feetech", "--servos", "1"]) as port:
        done = lipservo("setup-servos", "jaw", "--config", "face_jaw_feetech", "--port", port)
    assert done.returncode == 0, done.stderr
    assert "jaw: set up as id 1" in done.stdout


def test_new_face_writes_a_yaml_that_loads(tmp_path):
    path = tmp_path / "mine.yaml"
    with simulated_port(["--servos", "2", "--baud-rate", "1000000"]) as port:
        asked_again = "Brow!\njaw\n"  # no name of a joint, and the name of the first servo
        answers = f"jaw\nopens\ny\n{asked_again}brow\nraises\nn\n"
        done = lipservo("new-face", "-o", path, "--port", port, input=answers)
        assert done.returncode == 0, done.stderr
        assert "id 1 (XL330-M288) moved by 3.0 degrees. Which joint" in done.stderr
        assert "'Brow!' is not a joint's name" in done.stderr
        assert "joint jaw exists already" in done.stderr
    face = load_face(path)

    assert [(name, s.id, s.positive, s.sign) for name, s in face.servos.items()] == [
        ("jaw", 1, "opens", 1),
        ("brow", 2, "raises", -1),
    ]


def test_new_face_does_not_say_that_a_jammed_servo_moved(tmp_path, jammed):
    done = lipservo("new-face", "-o", tmp_path / "mine.yaml", "--port", jammed, input="y\n")
    assert "id 11 (XL330-M288) was told to move by 3 degrees and its position" in done.stderr
    assert "changed by 0.0; look whether it is blocked, or without power" in done.stderr
    assert "moved by" not in done.stderr


@pytest.mark.parametrize("model", ["STS3215", "SCS0009"])
def test_new_face_finds_feetech_servos_and_moves_each(tmp_path, model):
    path = tmp_path / "mine.yaml"
    how = ("new-face", "-o", path, "--bus", "feetech", "--port")
    with simulated_port(["--kind", "feetech", "--servos", "2", "--model", model]) as port:
        done = lipservo(*how, port, input="jaw\nopens\ny\nbrow\nraises\nn\n")
        assert done.returncode == 0, done.stderr
        as_dynamixel = lipservo("new-face", "-o", tmp_path / "other.yaml", "--port", port)
    face = load_face(path)

    assert face.bus.kind == "feetech"
    assert [(name, s.id, s.model, s.sign) for name, s in face.servos.items()] == [
        ("jaw", 1, model, 1),
        ("brow", 2, model, -1),
    ]
    assert as_dynamixel.returncode == 1
    assert "such as --bus feetech" in as_dynamixel.stderr


def test_new_face_on_two_buses_finds_one_and_asks_for_the_other(tmp_path):
    path = tmp_path / "mine.yaml"
    with simulated_port(["--servos", "1", "--baud-rate", "1000000"]) as port:
        buses = ("--bus", "lips=maestro", "--bus", "neck=dynamixel", "--port", f"neck={port}")
        answers = "mini12\njaw=0:opens\n\njaw\nneck_yaw\nturns left\ny\n"
        done = lipservo("new-face", "-o", path, *buses, input=answers)
    assert done.returncode == 0, done.stderr
    assert "joint jaw exists already" in done.stderr
    face = load_face(path)

    assert face.bus_of == ("lips", "neck")
    assert (face.servos["jaw"].channel, face.servos["neck_yaw"].id) == (0, 1)
    assert "Next: neutral and limits" in done.stdout


def test_new_face_says_so_when_its_answers_end_early(tmp_path):
    with simulated_port(["--servos", "1", "--baud-rate", "1000000"]) as port:
        done = lipservo("new-face", "-o", tmp_path / "mine.yaml", "--port", port, input="jaw\n")
    assert done.returncode == 1
    assert "the input ended before all questions were answered" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def ranges_of(folder, range_min, range_max, homing_offset=0, **ids):
    """A range file of lerobot, of a jaw with id 1 where no ids are given."""
    entry = {"drive_mode": 0, "homing_offset": homing_offset}
    entry |= {"range_min": range_min, "range_max": range_max}
    path = folder / "ranges.json"
    path.write_text(
        json.dumps({name: entry | {"id": n} for name, n in (ids or {"jaw": 1}).items()})
    )
    return path


def test_new_face_takes_names_and_limits_from_a_range_file_of_lerobot(tmp_path):
    """284 ticks are 24.96 degrees; the simulated servo stands at 2048, its neutral."""
    path, ranges = tmp_path / "mine.yaml", ranges_of(tmp_path, 2020, 2332)
    with simulated_port(["--servos", "1", "--baud-rate", "1000000"]) as port:
        how = ("new-face", "-o", path, "--port", port, "--ranges", ranges)
        done = lipservo(*how, input="\nopens\ny\n")
        assert done.returncode == 0, done.stderr
        jaw = load_face(path).servos["jaw"]
        assert (jaw.min_deg, jaw.max_deg) == (-2.46, 24.96)
        path.unlink()
        ranges_of(tmp_path, 2100, 2332)
        done = lipservo(*how, input="\nopens\ny\n")
        assert done.returncode == 1
        assert "jaw (id 1) is at position 20" in done.stderr
        assert "outside its recorded range 2100..2332" in done.stderr
        assert not path.exists()


def test_a_range_file_of_an_scs0009_keeps_its_neutral_where_it_stands(tmp_path):
    """400 to 620 of 1024 steps over 300 degrees, standing in the middle, at 512."""
    path, ranges = tmp_path / "mine.yaml", ranges_of(tmp_path, 400, 620, jaw=1, neck=9)
    with simulated_port(["--kind", "feetech", "--servos", "1", "--model", "SCS0009"]) as port:
        how = ("new-face", "-o", path, "--bus", "feetech", "--port", port, "--ranges", ranges)
        done = lipservo(*how, input="\nopens\ny\n")
    assert done.returncode == 0, done.stderr
    assert "id 9 (neck in " in done.stderr
    jaw = load_face(path).servos["jaw"]
    # It stands within a step of 0.3 degrees.
    assert (jaw.min_deg, jaw.max_deg) == pytest.approx((-32.8, 31.6), abs=0.35)
    assert jaw.zero_offset_deg == pytest.approx(0.0, abs=0.3)


def test_new_face_takes_over_servos_that_lerobot_has_homed(tmp_path):
    """Homed by -1024 ticks, driven in mode 4: shown at 1024, recorded there, standing at 2048."""
    path, ranges = tmp_path / "mine.yaml", ranges_of(tmp_path, 996, 1308, homing_offset=-1024)
    with simulated_port(["--servos", "1", "--baud-rate", "1000000"]) as port:

        def ask(act):
            with closing(open_port(port, 1_000_000)) as transport:
                return act(Line(transport))

        ask(lambda line: line.write(1, 20, (-1024).to_bytes(4, "little", signed=True)))
        ask(lambda line: line.write(1, 11, b"\4"))
        ask(lambda line: line.write(1, 52, (996).to_bytes(4, "little")))
        ask(lambda line: line.write(1, 48, (1308).to_bytes(4, "little")))
        how = ("new-face", "-o", path, "--port", port, "--ranges", ranges)
        done = lipservo(*how, input="n\n")
        assert done.returncode == 1
        assert "homing_offset is -1024, should be 0" in done.stderr
        assert "max_position_limit is 1308, should be 4095" in done.stderr
        assert not path.exists()
        done = lipservo(*how, input="y\n\nopens\ny\n")
        assert done.returncode == 0, done.stderr
        jaw = load_face(path).servos["jaw"]
        assert (jaw.min_deg, jaw.max_deg) == (-2.46, 24.96)
        assert ask(lambda line: line.read(1, 20, 4)).data == bytes(4)
        assert ask(lambda line: line.read(1, 11, 1)).data == b"\3"
        assert ask(lambda line: line.read(1, 48, 8)).data == bytes((0xFF, 0x0F, *[0] * 6))


def test_a_dry_run_reads_but_never_switches_torque_on(port, tmp_path):
    clip = clip_start(tmp_path, 1.0)
    done = lipservo("run", "--port", port, "--dry-run", "--json", "--wav", clip)

    assert done.returncode == 0, done.stderr
    assert '"frames_sent": 0' in done.stdout


HOBBY = {"maestro": lambda face: on_maestro_yaml(face, model="mini12"), "pca9685": on_pca9685}


@pytest.mark.parametrize("kind", HOBBY)
def test_neutral_gives_every_hobby_servo_its_pulse_says_so_and_files_that(tmp_path, kind):
    config, log = tmp_path / "face.yaml", tmp_path / "pulses.jsonl"
    config.write_text(HOBBY[kind](load_shipped_face("face_sim")))
    names = list(load_face(config).servos)
    state = {**os.environ, "LIPSERVO_STATE": str(tmp_path)}
    with simulated_port(["--config", str(config), "--log", str(log), "--on-time"]) as port:
        told = ("calibrate", "neutral", "--yes", "--config", config, "--port", port)
        done = lipservo(*told, env=state)
    assert done.returncode == 0, done.stderr
    pulses = [json.loads(line) for line in log.read_text().splitlines()]
    (kept,) = tmp_path.glob("pulses/*.json")

    assert done.stdout.splitlines() == [f"{each} was sent to 0.0 deg (1500 us)" for each in names]
    sent_us = {channel: pulse for _, channel, pulse, *_ in pulses if pulse}
    assert sent_us == pytest.approx(dict.fromkeys(range(10), 1500.0), abs=5.0)
    assert sorted(map(int, json.loads(kept.read_text())["pulses_us"])) == list(range(10))
