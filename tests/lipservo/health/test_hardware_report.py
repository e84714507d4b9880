"""`doctor --report`: what is measured, what leaves the computer, and what it refuses."""

import io
import json
import platform
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process import lipservo

from firmware_bridge.clock import ManualClock
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.health.hardware_report import (
    about_face,
    as_text,
    limp_loop,
    scrubbed,
    secrets_of,
    spread,
    step_answers,
    step_goals,
)
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.settings.settings import load_shipped_face, parse_face

NAME = st.from_regex(r"[a-z][a-z0-9_]{5,12}zq", fullmatch=True)


def face(name, joint, port):
    return parse_face(
        f"name: '{name}'\nrate_hz: 50\nbus: {{kind: maestro, model: micro6, port: '{port}'}}\n"
        f"servos: {{{joint}: {{channel: 3, positive: grandmazq, min_deg: 0, max_deg: 9, "
        "max_speed_deg_s: 300, us_per_deg: 10}}\n",
        "face.yaml",
    )


@given(NAME, NAME, NAME, NAME)
def test_no_name_and_no_path_is_in_what_is_said_of_a_face(name, joint, folder, serial):
    port = f"/dev/serial/by-id/usb-{serial}-if00"
    settings = face(name, joint, port)
    secrets = secrets_of(settings, f"/home/{folder}/face.yaml")
    said = {
        **about_face(settings),
        "findings": [
            {"severity": "bad", "remedy": "", "what": scrubbed(text, secrets)}
            for text in (
                f"{port}: no Maestro answers",
                f"servo '{joint}' (channel 3) is held by /home/{folder}/bin/{serial}: {name}",
                f"{platform.node()} ~/{folder} ./{folder}/x (/tmp/{serial})",
            )
        ],
    }

    for text in (json.dumps(said), as_text(said)):
        for secret in (name, joint, folder, serial, "grandmazq", platform.node()):
            assert secret not in text
        assert "servo_1" in text
        assert "micro6" in text


def test_a_device_number_is_no_word_of_a_report():
    assert scrubbed("adapter FT5A 00A50285BI is 1,000,000 baud at 5.0 V", []) == (
        "adapter FT5A 00A50285BI is 1,000,000 baud at 5.0 V"
    )
    assert scrubbed("serial 0123456789abcdef", []) == "serial [...]"


def test_a_step_is_described_by_what_its_shaft_did():
    """50 Hz: 40 ms late, 1 deg too far, at rest .2 deg off from 120 ms on."""
    goals_deg = np.concatenate([np.zeros(50), np.full(50, 5.0)])
    seen_deg = np.concatenate([np.zeros(52), [2.0, 6.0, 6.0, 5.7], np.full(44, 5.2)])

    assert step_answers(goals_deg, seen_deg, 50.0) == [
        {"step_deg": 5.0, "late_ms": 50.0, "settled_ms": 130.0, "beyond_deg": 1.0, "off_deg": 0.2}
    ]
    stuck = step_answers(goals_deg, np.zeros(100), 50.0)
    assert stuck == [
        {"step_deg": 5.0, "late_ms": None, "settled_ms": None, "beyond_deg": 0.0, "off_deg": -5.0}
    ]


@given(st.floats(-60.0, 0.0), st.floats(0.0, 60.0))
def test_steps_stay_within_the_limits_of_the_joint(min_deg, max_deg):
    goals_deg = step_goals(min_deg, max_deg, 50.0)

    assert min_deg <= goals_deg.min()
    assert goals_deg.max() <= max_deg
    assert np.abs(goals_deg).max() <= 5.0
    assert goals_deg[0] == goals_deg[-1] == 0.0


def test_limp_servos_are_read_and_written_and_none_gets_torque():
    settings, clock = load_shipped_face("face_four"), ManualClock()
    bus = SimulatedBus(settings.joints(), clock, start_deg=np.full(4, 3.0))
    with bus:
        told = limp_loop(bus, 50.0, 2.0, clock)

        assert not bus.read().torque.any()
        assert bus.read().positions_deg.tolist() == [3.0] * 4
    assert (told["n_ticks"], told["n_late"], told["unanswered"]) == (100, 0, [0] * 4)
    assert told["read_ms"] == told["write_ms"] == {"p50": 0.0, "p99": 0.0, "worst": 0.0}


def test_of_nothing_there_is_no_spread():
    assert spread([]) is None
    assert spread([1.0, 3.0]) == {"p50": 2.0, "p99": 2.98, "worst": 3.0}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--report", "x.json", "--port", "/dev/null"), "No terminal can be asked; give --yes"),
        (("--report", "x", "--port", "/dev/null"), "name the report like x.json"),
        (("--report", ".", "--port", "/dev/null"), "name the report like report.json"),
        (("--report", "x.json"), "no port: give --port"),
        (("--report", "no/x.json", "--port", "x", "--yes"), "there is no folder no"),
        (("--report", "x.json", "--port", "x", "--move", "tongue"), "no joint 'tongue'"),
        (("--move", "jaw", "--port", "x"), "--move and --yes need --report"),
    ],
)
def test_what_it_refuses_is_one_line_and_nothing_is_written(
    tmp_path, monkeypatch, arguments, words
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    done = lipservo("doctor", *arguments)

    assert done.returncode in (1, 2)
    assert words in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("face", ["face_sim", "face_jaw_maestro", "face_head_mixed"])
def test_a_port_that_is_dead_is_in_the_report(tmp_path, face):
    """Of a face with several buses each is examined, the dead and the others."""
    port = "lips=/dev/ttyUSB77" if face == "face_head_mixed" else "/dev/ttyUSB77"
    file = tmp_path / "report.json"
    how = ("--report", file, "--config", face, "--yes", "--seconds", "1")
    done = lipservo("doctor", *how, "--port", port)
    found = json.loads(file.read_text())

    assert done.returncode == 1
    assert "ttyUSB77" in done.stderr
    bad = [each["what"] for each in found["findings"] if each["severity"] == "bad"]
    assert any("no such port" in what for what in bad), found["findings"]
    assert "no such port" in found["limp_loop"]["error"]
    assert found["steps"] is None
    text = file.read_text()
    assert "ttyUSB77" not in text
    assert '"lips"' not in text or face != "face_head_mixed"


def test_bad_findings_are_its_exit_status_and_json_its_answer(tmp_path):
    """A servo of low voltage is found bad; reading and writing it work."""
    script = tmp_path / "faults.yaml"
    script.write_text("faults: [{kind: undervoltage, servos: [0], at_s: 0.0}]")
    at = ["--config", "face_four", "--on-time", "--faults", str(script)]
    for how in ((), ("--json",)):
        file = tmp_path / f"report{len(how)}.json"
        options = ("--config", "face_four", "--yes", "--seconds", "1", *how)
        with simulated_port(at) as port:
            done = lipservo("doctor", "--report", file, "--port", port, *options)
        found = json.loads(file.read_text())["findings"]
        n_bad = sum(each["severity"] == "bad" for each in found)

        assert n_bad > 0
        assert done.returncode == 1
        if how:
            assert json.loads(done.stdout) == {"bad": n_bad, "findings": found, "error": ""}
        else:
            assert f"report0.txt ({n_bad} bad findings): read them" in done.stdout.replace("\n", "")


@pytest.mark.slow
def test_a_whole_report_of_simulated_servos_has_figures_and_no_secret(tmp_path):
    with simulated_port(["--config", "face_four", "--on-time"]) as port:
        file = tmp_path / "report.json"
        done = lipservo(
            "doctor", "--report", file, "--config", "face_four", "--port", port, "--yes",
            "--move", "jaw", "--seconds", "1",
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found = json.loads(file.read_text())

        assert found["limp_loop"]["n_confirmed_limp"] == 4
        assert found["limp_loop"]["read_ms"]["p50"] > 0.0
        assert found["steps"]["n_let_go"] == 4
        assert [round(abs(each["step_deg"])) for each in found["steps"]["answers"]] == [5] * 6
        assert all(each["settled_ms"] is not None for each in found["steps"]["answers"])
        for text in (file.read_text(), file.with_suffix(".txt").read_text()):
            assert port not in text
            assert str(tmp_path) not in text
            for name in load_shipped_face("face_four").servos:
                assert f" {name} " not in text
                assert f'"{name}"' not in text


@pytest.mark.slow
def test_a_signal_lets_the_servos_go_and_leaves_no_file(tmp_path):
    with simulated_port(["--config", "face_four", "--on-time"]) as port:
        command = [sys.executable, "-m", "lipservo", "doctor", "--config", "face_four"]
        options = ["--port", port, "--report", str(tmp_path / "r.json"), "--yes", "--seconds", "60"]
        with subprocess.Popen([*command, *options], stderr=subprocess.PIPE, text=True) as process:
            for line in process.stderr:
                if line.startswith("reading and writing"):
                    break
            time.sleep(0.5)
            process.send_signal(signal.SIGTERM)
            rest = process.stderr.read()

    assert process.returncode == 128 + signal.SIGTERM
    assert "the servos are let go, and nothing was written" in rest
    assert list(tmp_path.iterdir()) == []
