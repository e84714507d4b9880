"""`stop`, `status` and `limp` as a person types them: no face, one, two, and a port without any."""

import json
import os
import socket
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing

import pytest
from in_process import lipservo
from playing_face import HELD, invoke
from playing_face import listening as face
from running_daemon import torque

from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.feetech.control_table import TORQUE_ENABLE
from firmware_bridge.feetech.line import Line as FeetechLine
from firmware_bridge.feetech.torque import torque_verified
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.port_holders import holders_of
from firmware_bridge.process.runtime_folder import (
    _folders_of_others,
    runtime_folder,
    searched_folders,
)
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.stopping import StopLevel
from lipservo.runtime.servos.sim_process import simulated_port
from lipsync.errors import UserError

pytestmark = pytest.mark.usefixtures("own_folder")
RUNTIME = "firmware_bridge.process.runtime_folder"
BAUD_RATE = 2_000_000


def faces(result):
    return json.loads(result.stdout)["faces"]


@pytest.mark.parametrize("command", ["stop", "limp", "set strength 0.5", "servo jaw off"])
def test_without_a_face_a_command_says_so_and_status_lists_none(command):
    done = invoke(*command.split())

    assert done.exit_code == 1
    assert isinstance(done.exception, UserError)
    assert str(done.exception).startswith(("no face answers", "no face runs"))
    assert faces(invoke("status", "--json")) == []


@pytest.mark.parametrize(
    ("options", "level"),
    [([], StopLevel.SOFT), (["--limp"], StopLevel.LIMP), (["--freeze"], StopLevel.FREEZE)],
)
def test_stop_without_a_name_stops_all_and_with_one_only_that(options, level):
    with ExitStack() as stack:
        tim, tom = stack.enter_context(face("tim")), stack.enter_context(face("tom"))
        listed = faces(invoke("status", "--json"))
        one = invoke("stop", *options, "--face", "tim", "--json")
        both = invoke("stop", *options)
        unknown = invoke("stop", "--face", "tam")

    assert [(e["name"], e["port"]) for e in listed] == [("tim", "/dev/tim"), ("tom", "/dev/tom")]
    assert [each["name"] for each in faces(one)] == ["tim"]
    assert (one.exit_code, both.exit_code) == (0, 0)
    assert (tim, tom) == ([level, level], [level])
    assert "running: tim, tom" in str(unknown.exception)


@pytest.mark.parametrize(
    ("held", "line", "status"),
    [
        (HELD, "tim: held where it is: 1 servo holds; left limp", 0),
        (HELD | {"holds": [], "limp": ["jaw", "left"]}, "tim: nothing is held; 2 servos limp", 1),
        (HELD | {"limp": [], "unknown": ["left"]}, "not known of left", 1),
        ({}, "tim: accepted, but does not say what it holds", 1),
    ],
)
def test_a_freeze_says_what_is_held_and_its_exit_status_too(held, line, status):
    with face("tim", held=held):
        frozen = invoke("stop", "--freeze")

    assert line in frozen.stdout
    assert frozen.exit_code == status


def test_every_face_is_sent_the_stop_before_one_in_trouble_is_waited_for():
    """The first of two faces by name accepts connections and never answers."""
    folder = runtime_folder()
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as deaf,
        face("tom") as heard,
        ThreadPoolExecutor(1) as pool,
    ):
        deaf.bind(str(folder / "aaa-1.sock"))
        deaf.listen()
        waiting = pool.submit(invoke, "stop", "--limp")
        while not heard:
            assert not waiting.done()
        stopped_before_the_other = not waiting.done()
        deaf.close()
        done = waiting.result()

    assert stopped_before_the_other
    assert heard[0] is StopLevel.LIMP
    assert done.exit_code == 1  # of the other nothing is known


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make the folder of another user")
def test_root_looks_only_into_folders_that_belong_to_the_user_in_their_name(own_folder):
    """A socket of a stranger in a folder that is not his: it is neither asked nor believed."""
    own, foreign = own_folder / "lipservo-4242", own_folder / "lipservo-4243"
    for each in (own, foreign):
        each.mkdir(mode=0o700)
        os.chown(each, 4242, 4242)
    for each, expected in ((own, [own]), (foreign, [])):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(f"{RUNTIME}._folders_of_others", lambda each=each: iter([each]))
            assert [found for found in searched_folders() if found == each] == expected


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make the folder of another user")
@pytest.mark.parametrize("kind", ["session", "temporary"])
def test_a_folder_with_our_number_that_somebody_else_has_made_is_not_looked_into(
    own_folder, monkeypatch, kind
):
    monkeypatch.setattr(tempfile, "tempdir", str(own_folder))
    if kind == "temporary":
        monkeypatch.delenv("XDG_RUNTIME_DIR")
        folder = own_folder / f"lipservo-{os.geteuid()}"
    else:
        folder = own_folder / "lipservo"
    folder.mkdir(mode=0o700)

    assert folder in searched_folders()
    os.chown(folder, 4242, 4242)
    assert folder not in searched_folders()


def test_a_job_with_a_runtime_folder_of_its_own_neither_finds_nor_stops_other_faces(
    own_folder, monkeypatch
):
    with face("tim") as tim:
        monkeypatch.setenv("LIPSERVO_RUNTIME", str(own_folder / "job-7"))
        with face("tom") as tom:
            listed = faces(invoke("status", "--json"))
            invoke("stop")

    assert [each["name"] for each in listed] == ["tom"]
    assert (tim, tom) == ([], [StopLevel.SOFT])


@pytest.mark.skipif(os.geteuid() != 0, reason="only root looks into folders of others")
@pytest.mark.parametrize("name", ["lipservo-job", "lipservo-2m025j_8", "lipservo-7-b"])
def test_root_stops_no_face_of_a_job_that_keeps_apart(own_folder, monkeypatch, name):
    monkeypatch.setattr(tempfile, "tempdir", str(own_folder))
    monkeypatch.setattr(f"{RUNTIME}._folders_of_others", _folders_of_others)
    monkeypatch.setenv("LIPSERVO_RUNTIME", str(own_folder / name))
    with face("tom") as tom:
        monkeypatch.delenv("LIPSERVO_RUNTIME")
        invoke("stop")
    assert tom == []


def hold(port, *ids):
    with closing(open_port(port, BAUD_RATE)) as transport:
        for each in ids:
            Line(transport).write(each, 64, b"\1")


def test_a_port_is_never_opened_because_an_answer_names_it(port):
    """A face that goes without a report and says that this port is its own."""
    hold(port, 6)
    path = runtime_folder() / "liar-1.sock"

    def lie():
        with ControlSocket(path, {"name": "liar", "port": port}) as control:
            while control.poll() is None:
                pass
            control.answer(dict)

    with ThreadPoolExecutor(1) as pool:
        lying = pool.submit(lie)
        while not path.exists():
            pass
        done = invoke("stop", "--json")
        lying.result()

    assert done.exit_code == 1
    assert f"lipservo limp --port {port}" in faces(done)[0]["problem"]
    assert torque(port, [6], BAUD_RATE) == [1]


REPORT = {"confirmed": ["jaw"], "unconfirmed": {"left": "did not answer"}}
NOT_KNOWN = {"jaw": {"on": None, "age_s": None}, "left": {"on": None, "age_s": None}}


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (
            {"state": "stopped", "stopped_by": "process 7 of user 0", "stop_report": REPORT},
            "stopped by process 7 of user 0: limp, confirmed by 1 servos, NOT by left",
        ),
        (
            {"state": "driven", "plugged": False, "torque": NOT_KNOWN}
            | {"servos": dict.fromkeys(NOT_KNOWN, "waiting"), "troubles": []},
            "driven, but its port is gone: no servo can be reached",
        ),
        ({"state": "driven", "torque": NOT_KNOWN}, "driven, it is not known which servos hold"),
    ],
    ids=["stopped", "unplugged", "not known"],
)
def test_a_status_says_what_is_known_and_counts_no_servos_that_nothing_is_known_of(status, words):
    with face("tom", status=status):
        shown = invoke("status").stdout

    assert words in shown
    assert "0 of 2" not in shown


PARENT = """
import subprocess, sys
# lipservo: a script whose command line has this word in it
holder = subprocess.Popen([sys.executable, "-c", sys.argv[2], sys.argv[1], "lipservo"])
print(holder.pid, flush=True)
sys.stdin.read()
"""
HOLDER = """
import sys, time
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.dynamixel.wire.line import Line
transport = open_port(sys.argv[1], 2_000_000)
Line(transport).write(7, 64, b"\\1")
time.sleep(600)
"""


def test_limp_at_a_port_ends_the_holder_and_never_its_parent(port):
    """A shell, tmux or script with `lipservo` in its command line is no supervisor."""
    arguments = [sys.executable, "-c", PARENT, port, HOLDER]
    with subprocess.Popen(
        arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as script:
        holder = int(script.stdout.readline())
        while holder not in holders_of(port):
            assert os.path.exists(f"/proc/{holder}/fd/0"), "it could not hold the port"
        done = invoke("limp", "--port", port, "--json")
        lives = script.poll() is None
        script.stdin.close()

    assert done.exit_code == 0, done.output
    assert lives
    assert "id 7" in faces(done)[0]["confirmed"]


def test_a_servo_that_did_not_confirm_is_named_and_the_exit_status_says_it():
    with face("tom", unconfirmed={"left": "did not answer"}):
        done = invoke("stop")

    assert done.exit_code == 1
    assert "NOT by left: did not answer" in done.stdout


def test_status_shows_servos_and_no_dead_faces(own_folder):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead, face("tom"):
        dead.bind(str(own_folder / "lipservo" / "tim-1.sock"))
        dead.close()
        shown = invoke("status").stdout

    assert shown.startswith("tom ")
    assert "1 of 2 servos hold, not known of 1" in shown
    assert "tim" not in shown


def test_a_start_of_a_face_whose_only_servo_is_switched_off_is_over_at_once():
    off = {"state": "driven", "servos": {"jaw": "off"}, "torque": {"jaw": {"on": False}}}
    with face("tom", status=off):
        shown = invoke("start")

    assert shown.exit_code == 0, shown.output


@pytest.fixture(scope="module")
def port():
    arguments = ["--servos", "3", "--first-id", "5", "--baud-rate", str(BAUD_RATE), "--on-time"]
    with simulated_port(arguments) as port:
        yield port


def test_limp_lets_go_of_whatever_hangs_on_a_port_at_any_rate(port):
    """No face, no configuration: as after `kill -9` of somebody else's program."""
    hold(port, 5, 6, 7)
    done = invoke("limp", "--port", port, "--json")

    assert done.exit_code == 0, done.output
    assert faces(done)[0]["confirmed"] == ["id 5", "id 6", "id 7"]
    assert torque(port, [5, 6, 7], BAUD_RATE) == [0, 0, 0]


def test_limp_lets_go_of_feetech_servos_that_nothing_is_known_of():
    """As after the plug was pulled, which leaves them holding: what drove them is forgotten."""
    with simulated_port(["--kind", "feetech", "--servos", "2", "--on-time"]) as port:
        with closing(open_port(port, 1_000_000)) as transport:
            assert torque_verified(FeetechLine(transport), 1, on=True)
            assert torque_verified(FeetechLine(transport), 2, on=True)
        done = invoke("limp", "--port", port, "--json")
        with closing(open_port(port, 1_000_000)) as transport:
            line = FeetechLine(transport)
            torque = [line.read(each, TORQUE_ENABLE, 1).data for each in (1, 2)]

    assert done.exit_code == 0, done.output
    assert faces(done)[0]["confirmed"] == ["id 1", "id 2"]
    assert torque == [b"\0"] * 2


def test_limp_of_a_face_whose_servos_are_not_there_names_each_and_fails(port):
    done = invoke("limp", "--port", port, "--config", "face_jaw", "--json")

    assert done.exit_code == 1
    assert set(faces(done)[0]["unconfirmed"].values()) == {"did not answer"}


@pytest.mark.parametrize(("place", "confirmed"), [("", 3), ("/gone", 0)])
def test_limp_at_a_port_needs_no_yaml_that_can_be_read(port, tmp_path, place, confirmed):
    """Whether or not the servos confirm, what is wrong with the YAML is said as well."""
    broken = tmp_path / "face.yaml"
    broken.write_text("nmae: tom\n")
    hold(port, 5)
    done = lipservo("limp", "--port", port + place, "--config", broken, "--json")

    assert done.returncode == 1
    assert "nmae" in done.stderr
    assert len(json.loads(done.stdout)["faces"][0]["confirmed"]) == confirmed
    assert torque(port, [5], BAUD_RATE) == [int(not confirmed)]


def test_limp_leaves_the_faces_at_other_ports_alone(port):
    with face("tom") as heard:
        invoke("limp", "--port", port)

    assert heard == []


def test_a_service_that_has_ended_leaves_a_port_that_somebody_holds_alone(port):
    with closing(open_port(port, BAUD_RATE)) as transport:
        line = Line(transport)
        line.write(5, 64, b"\1")
        done = invoke("limp", "--unless-held", "--port", os.path.relpath(port))
        held = line.read(5, 64, 1).data

    assert done.exit_code == 0
    assert held == b"\1"


def test_limp_at_a_port_that_is_not_there_is_one_line():
    done = invoke("limp", "--port", "/dev/no_such_port")

    assert done.exit_code == 1
    assert "/dev/no_such_port: no such port" in done.stdout


def test_of_a_face_that_is_silent_status_says_how_long_and_not_that_it_hangs():
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as deaf:
        deaf.bind(str(runtime_folder() / "aaa-1.sock"))
        deaf.listen()
        shown = invoke("status").stdout
        asked = invoke("servo", "jaw", "off")

    assert "has not answered within 2 s; if it has hung, `lipservo stop --limp` ends it" in shown
    assert "aaa: has not answered within 2 s" in asked.stderr
