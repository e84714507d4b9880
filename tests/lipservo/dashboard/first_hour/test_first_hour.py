"""The state of a face that is being made: what may be named, wired, limited and written."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from lipservo_client.protocol import FaceError
from places import ROOT

from lipservo.dashboard.face_link import NothingDrivenError
from lipservo.dashboard.first_hour.first_hour import FirstHour
from lipservo.dashboard.first_hour.step_process import StepProcess
from lipservo.runtime.servos.new_face import FoundJoint, face_yaml
from lipservo.settings.found_limits import turned_values, with_ranges
from lipservo.settings.settings import load_face, load_shipped_face
from lipsync.errors import UserError


@pytest.fixture
def path(tmp_path):
    return tmp_path / "tom.yaml"


@pytest.fixture
def wired(path):
    hour = FirstHour(path)
    hour.choose_port(None, "maestro", simulated=False)
    return hour


def test_hobby_servos_are_wired_on_the_page_and_written_with_narrow_limits(wired, path):
    wired.change_wiring("jaw=0:opens")
    wired.change_wiring("lip=1:raises")
    wired.change_wiring("lip")  # taken back

    wired.write_face()

    face = load_face(path)
    assert list(face.servos) == ["jaw"]
    assert face.servos["jaw"].pulse.min_us == 1400
    assert wired.state()["face"]["has_place"] is False


@pytest.mark.parametrize(
    ("channel", "why"),
    [("jaw=0", "add what a longer pulse does"), ("Jaw=0:opens", "is not a joint's name")],
)
def test_what_cannot_be_wired_is_refused_in_one_line(wired, channel, why):
    with pytest.raises(FaceError, match=why) as refused:
        wired.change_wiring(channel)

    assert refused.value.code == "refused"


@pytest.mark.parametrize(("step", "lacks"), [("nudge", "id"), ("measure", "tracker")])
def test_a_step_without_what_it_needs_is_refused_in_one_line(wired, monkeypatch, step, lacks):
    monkeypatch.setattr(FirstHour, "_check_port", lambda _hour: None)
    wired.change_wiring("jaw=0:opens")
    wired.write_face()

    with pytest.raises(FaceError, match=f"{step} needs `{lacks}`") as refused:
        wired.start(step)

    assert refused.value.code == "refused"


def test_a_face_without_servos_is_not_written(wired, path):
    with pytest.raises(FaceError, match="no servos given"):
        wired.write_face()

    assert not path.exists()


def test_a_face_that_is_there_is_gone_on_with_and_never_written_over(wired, path):
    wired.change_wiring("jaw=0:opens")
    wired.write_face()
    before = path.read_bytes()

    again = FirstHour(path)

    assert list(again.state()["face"]["servos"]) == ["jaw"]
    again.choose_port(None, "maestro", simulated=False)
    again.change_wiring("lip=0:raises")
    with pytest.raises(FaceError, match="exists"):
        again.write_face()
    assert path.read_bytes() == before


def test_a_face_on_several_buses_and_a_file_that_is_no_face_are_refused(path):
    path.write_text("name: tom\nservos: {}\n")
    with pytest.raises(UserError):
        FirstHour(path)


@pytest.mark.parametrize("step", ["limits", "by_eye", "measure", "speak"])
def test_no_step_on_servos_begins_before_they_have_names(path, step):
    with pytest.raises(FaceError, match="no face yet; name its servos"):
        FirstHour(path).start(step)


def test_limits_that_nobody_set_are_not_written(path):
    found = [FoundJoint("jaw", 1, "XL330-M288", "opens", 1)]
    from firmware_bridge.bus_kinds import bus_kind

    path.write_text(face_yaml("tom", bus_kind("dynamixel"), "/dev/none", 1_000_000, found))
    hour = FirstHour(path)

    with pytest.raises(FaceError, match="has not told its angle"):
        hour.store_limit("jaw", "min")
    with pytest.raises(FaceError, match="set min and max of one first"):
        hour.write_limits()


def test_what_joints_have_set_that_are_not_complete_outlasts_the_writing_of_others(path):
    found = [FoundJoint(name, n, "XL330-M288", "opens", 1) for n, name in enumerate(("jaw", "lip"))]
    from firmware_bridge.bus_kinds import bus_kind

    path.write_text(face_yaml("tom", bus_kind("dynamixel"), "/dev/none", 1_000_000, found))
    hour = FirstHour(path)
    hour._ends = {"jaw": {"min": 0.0, "neutral": 0.0, "max": 27.0}, "lip": {"neutral": 3.0}}

    hour.write_limits()

    assert hour.state()["ends"] == {"lip": {"neutral": 3.0}}
    jaw, lip = load_face(path).servos.values()
    assert (jaw.min_deg, jaw.max_deg, lip.zero_offset_deg) == (0.0, 25.0, 0.0)
    hour.close()


@pytest.mark.parametrize(("face", "step"), [("face_jaw_maestro", "speak"), ("face_sim", "limits")])
def test_without_a_port_no_step_moves_servos_in_memory_as_if_they_were_real(path, face, step):
    path.write_text(ROOT.joinpath("config", f"{face}.yaml").read_text())
    with contextlib.closing(FirstHour(path)) as hour:
        hour.start(step)
        hour._step.wait()

        assert hour.state()["step"]["error"].startswith("no port: give --port, or write `port:`")


def test_a_calibration_of_other_limits_is_none(path):
    shipped = load_shipped_face("face_jaw")
    path.write_text(ROOT.joinpath("config/face_jaw.yaml").read_text())
    made = path.with_name(shipped.calibration)
    made.write_text(ROOT.joinpath("config", shipped.calibration).read_text())
    hour = FirstHour(path)
    assert hour.state()["face"]["calibration"] == shipped.calibration

    with_ranges(path, {next(iter(shipped.servos)): {"max_deg": 9.0}}).write()

    assert hour.state()["face"]["calibration"] is None


def test_a_neutral_shown_by_hand_moves_zero_and_leaves_the_ends_of_the_servo_where_they_are():
    before_deg, neutral_deg = 3.0, 5.0
    found = turned_values(-20.0, 30.0, neutral_deg, before_deg)

    # servo angle = joint angle + zero_offset_deg, 2 degrees inside of what the hand showed
    assert found["zero_offset_deg"] == before_deg + neutral_deg
    assert found["min_deg"] + found["zero_offset_deg"] == pytest.approx(-20.0 + 2.0 + before_deg)
    assert found["max_deg"] + found["zero_offset_deg"] == pytest.approx(30.0 - 2.0 + before_deg)


def test_a_neutral_outside_of_the_ends_is_refused():
    with pytest.raises(UserError, match="its neutral, 0, must lie between"):
        turned_values(10.0, 30.0, 0.0, 0.0)


def test_a_servo_of_the_neck_is_no_mouth():
    joint = FoundJoint("neck_yaw", 2, "XL330-M288", "turns left", 1, part="neck")
    from firmware_bridge.bus_kinds import bus_kind
    from lipservo.settings.settings import parse_face

    text = face_yaml("tom", bus_kind("dynamixel"), "/dev/none", 1_000_000, [joint])

    assert parse_face(text, "tom.yaml").servos["neck_yaw"].part == "neck"


def test_a_step_at_a_port_that_is_not_there_says_so_in_one_line(path):
    hour = FirstHour(path, "/dev/no_such_port")  # who is there is asked at once

    hour._step.wait()

    told = hour.state()["step"]
    assert told["runs"] is False
    assert "/dev/no_such_port" in told["error"]
    assert "Traceback" not in json.dumps(told)
    with pytest.raises(NothingDrivenError, match="without a word of its servos") as stopped:
        hour.control_path()
    assert not stopped.value.is_limp


def test_between_steps_no_servo_is_driven_and_a_stop_says_so(path):
    with pytest.raises(NothingDrivenError, match="no servo is driven now") as stopped:
        FirstHour(path).control_path()

    assert stopped.value.is_limp


@pytest.mark.parametrize(
    ("step", "goes_on"),
    [("limits", False), ("jog", False), ("by_eye", False), ("measure", True), ("speak", True)],
)
def test_a_step_whose_servos_hold_for_a_person_ends_when_no_page_was_open_for_15_s(
    path, step, goes_on
):
    hour = FirstHour(path)
    assert hour._may_run(step)()

    hour._page_seen_s = time.monotonic() - 20.0
    assert hour._may_run(step)() is goes_on


def test_a_step_that_nobody_wants_is_ended():
    ended = []
    step = StepProcess(
        "find",
        {"port": "/dev/null", "kind": "dynamixel"},
        may_run=lambda: False,
        on_end=ended.append,
    )

    step.wait()

    assert ended == [step]
    assert not step.runs


COMPLAINTS = {
    "cause and advice": (
        ["id 11 is in mode 3, not 5", "`doctor` examines it"],
        "id 11 is in mode 3, not 5; `doctor` examines it",
    ),
    "many": (
        [*(f"id {n} is silent" for n in range(60)), "see docs"],
        "id 0 is silent; id 1 is silent; ...; see docs",
    ),
}


@pytest.fixture
def does(monkeypatch):
    """Let each step's process run a script of the test's in place of its own."""
    real = subprocess.Popen

    def run(script):
        monkeypatch.setattr(
            "lipservo.dashboard.first_hour.step_process.subprocess.Popen",
            lambda _command, **how: real([sys.executable, "-c", script], **how),
        )

    return run


@pytest.mark.parametrize(("lines", "shown"), COMPLAINTS.values(), ids=COMPLAINTS)
def test_why_a_step_failed_is_its_cause_and_then_the_advice(does, lines, shown):
    said = "".join(f"lipservo: {line}\n" for line in lines)
    said = f"busy\nlipservo: not that\nbusy\n{said}"
    does(f"import sys; sys.stderr.write({said!r}); sys.exit(1)")

    step = StepProcess("find", {})
    step.wait()

    assert step.error == shown


#: Ends by SIGTERM as a face does one of whose servos does not confirm torque off.
UNCONFIRMED = """
import os, signal, time
def end(*_):
    os.write(2, b"ended; torque off confirmed by 0 servos, NOT by jaw")
    os._exit(3)
signal.signal(signal.SIGTERM, end)
print('{"event": "ready"}', flush=True)
time.sleep(60)
"""


def test_a_step_whose_servos_do_not_confirm_that_they_are_limp_says_so(wired, does):
    wired.change_wiring("jaw=0:opens")
    wired.write_face()
    does(UNCONFIRMED)
    wired.start("jog")
    while not wired._step.events:
        time.sleep(0.01)

    wired._page_seen_s = time.monotonic() - 20.0
    wired._step.wait()

    state = wired.state()
    assert "keep your hands away: ended; torque off" in state["step"]["error"]
    assert state["step"]["error"].endswith("NOT by jaw")
    assert "no browser had this page open" in state["note"]
    assert "let go" not in state["note"]
    assert state["ended_well"] == {"jog": False}


@pytest.mark.parametrize(("status", "well"), [(0, True), (1, False)])
def test_a_step_counts_as_done_where_it_ended_well_the_last_time(wired, does, status, well):
    wired.change_wiring("jaw=0:opens")
    wired.write_face()
    does(f"raise SystemExit({status})")
    wired.start("jog")
    wired._step.wait()

    assert wired.state()["ended_well"] == {"jog": well}


def test_a_real_port_that_is_chosen_ends_the_rehearsal(path):
    hour = FirstHour(path, simulated=True)
    servos = hour._simulated.process
    hour.end_step()  # while it searches
    hour._step.wait()
    assert hour.state()["simulated"] is True

    hour.choose_port("/dev/no_such_port", "maestro", simulated=False)

    assert hour.state()["simulated"] is False
    assert servos.poll() is not None


def test_a_step_that_hangs_when_it_should_end_is_killed_and_says_what_may_still_hold():
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)  # which a child inherits
    try:
        step = StepProcess("find", {"port": "/dev/null", "kind": "dynamixel"}, end_s=0.5)
        while step.pid is None:
            time.sleep(0.001)
        os.kill(step.pid, signal.SIGSTOP)

        step.end()
        step.wait()
    finally:
        signal.signal(signal.SIGTERM, before)

    assert not step.runs
    assert "was killed: its servos may still hold" in step.error
    assert not step.is_limp


def test_orders_to_a_step_that_hangs_hold_up_no_thread_of_the_server():
    step = StepProcess("find", {"port": "/dev/null", "kind": "dynamixel"})
    while step.pid is None:
        time.sleep(0.001)
    os.kill(step.pid, signal.SIGSTOP)

    def drag_a_slider():
        for _ in range(2_000):  # more than a pipe holds
            step.order({"joint": "j" * 60, "deg": 1.0})

    thread = threading.Thread(target=drag_a_slider, daemon=True)
    thread.start()
    thread.join(20.0)
    was_held_up = thread.is_alive()
    os.kill(step.pid, signal.SIGKILL)
    step.wait()

    assert not was_held_up
    assert not step.runs
