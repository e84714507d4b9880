"""A stop is acted on before anybody is answered, whoever else is there; in one thread, by steps."""

import json
import os
import socket

import pytest

from firmware_bridge.process.commands import CommandQueue
from firmware_bridge.process.control_socket import LONGEST_WORD, ControlSocket
from firmware_bridge.process.runtime_folder import ControlError
from firmware_bridge.stopping import StartFace, StopLevel, StopRequest

US = f"process {os.getpid()} of user {os.getuid()}"
MOST_CLIENTS = 16


@pytest.fixture
def control(tmp_path):
    with ControlSocket(tmp_path / "face.sock", {"name": "tom"}) as control:
        yield control


class Client:
    """Somebody at the socket of a face who never waits."""

    def __init__(self, control):
        self._end = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._end.connect(str(control.path))
        self._end.setblocking(False)

    def says(self, word):
        self._end.send(word.encode())
        return self

    def heard(self):
        """The next answer; "" where there is none, None where the face has hung up."""
        try:
            raw = self._end.recv(10_000)
        except BlockingIOError:
            return ""
        return json.loads(raw) if raw else None

    def leaves(self):
        self._end.close()


@pytest.fixture
def client(control):
    """Makes clients, gone when the test is over."""
    made = []

    def one():
        made.append(Client(control))
        return made[-1]

    yield one
    for each in made:
        each.leaves()


@pytest.mark.parametrize("level", list(StopLevel))
def test_a_stop_is_handed_to_the_loop_before_its_asker_hears_that_it_is_accepted(
    control, client, level
):
    asker = client().says(level.value)

    assert control.poll() == StopRequest(level, US)
    assert asker.heard() == ""

    control.answer(dict)
    assert asker.heard() == {"accepted": level.value, "name": "tom"}


def test_what_the_answer_to_a_stop_says_of_servos_is_read_once_the_stop_was_acted_on(
    control, client
):
    limp = []
    asker = client().says("limp")
    control.poll()
    limp.append("jaw")
    control.answer(dict, lambda: {"limp": list(limp), "name": "not of the servos"})

    assert asker.heard() == {"accepted": "limp", "limp": ["jaw"], "name": "tom"}
    client().says("status")
    control.poll()
    control.answer(dict, lambda: pytest.fail("no stop was asked for"))


@pytest.mark.parametrize("ends", [False, True])
def test_a_stop_tells_who_asked_and_whether_the_process_ends(control, client, ends):
    client().says("limp end" if ends else "limp")

    assert control.poll() == StopRequest(StopLevel.LIMP, US, ends=ends)
    assert control.poll() is None


def test_whoever_asked_for_a_stop_last_is_answered_before_those_who_asked_for_anything_else(
    control, client
):
    early = client().says("status")
    commanding = client().says("set x 1")
    stopping = client().says("limp")
    control.poll()

    def status():
        assert stopping.heard() == {"accepted": "limp", "name": "tom"}
        assert early.heard() == ""
        return {"state": "limp"}

    control.answer(status)
    assert early.heard() == {"state": "limp", "name": "tom"}
    assert "error" in commanding.heard()


def test_who_connects_and_says_stop_only_later_is_heard(control, client):
    slow = client()
    assert control.poll() is None
    assert control.poll() is None
    slow.says("freeze")

    assert control.poll() == StopRequest(StopLevel.FREEZE, US)


def test_of_stops_that_come_together_the_furthest_counts_and_all_askers_hear_of_theirs(
    control, client
):
    askers = {level: client().says(level) for level in ("freeze", "limp", "soft")}

    assert control.poll() == StopRequest(StopLevel.LIMP, US)
    control.answer(dict)
    for level, asker in askers.items():
        assert asker.heard() == {"accepted": level, "name": "tom"}


def test_many_who_come_at_once_are_all_heard(control, client):
    askers = [client().says("limp") for _ in range(10)]
    for _ in range(10):
        control.poll()
    control.answer(dict)

    assert all(each.heard() == {"accepted": "limp", "name": "tom"} for each in askers)


def test_a_status_that_cannot_be_made_is_told_and_ends_nothing(control, client):
    asker = client().says("status")
    control.poll()

    def broken():
        raise ZeroDivisionError("no\nticks")

    control.answer(broken)
    why = "the status cannot be made: ZeroDivisionError: no ticks"
    assert asker.heard() == {"name": "tom", "state": "unknown", "error": why}


def test_the_status_is_made_only_for_who_asks(control, client):
    client().says("limp")
    control.poll()

    control.answer(lambda: pytest.fail("nobody asked for it"))
    control.answer(lambda: pytest.fail("nobody asked for it"))


def test_the_oldest_who_says_nothing_makes_room_and_never_who_waits_for_the_end_of_a_stop(
    control, client
):
    stopping = client().says("limp")
    control.poll()
    idle = [client() for _ in range(MOST_CLIENTS - 1)]
    for _ in range(MOST_CLIENTS):
        control.poll()
    assert all(each.heard() == "" for each in idle)
    newest = client().says("freeze")

    assert control.poll() == StopRequest(StopLevel.FREEZE, US)
    assert idle[0].heard() is None
    assert all(each.heard() == "" for each in idle[1:])
    control.answer(dict)
    assert [each.heard()["accepted"] for each in (stopping, newest)] == ["limp", "freeze"]


def test_where_all_wait_for_the_end_of_a_stop_another_stop_is_still_heard(control, client):
    waiting = [client().says("freeze") for _ in range(MOST_CLIENTS)]
    for _ in range(MOST_CLIENTS):
        control.poll()
    client().says("limp")

    assert control.poll() == StopRequest(StopLevel.LIMP, US)
    assert waiting[0].heard() is None
    assert waiting[1].heard() == ""


def test_who_asks_for_a_stop_and_leaves_at_once_has_stopped_the_face(control, client):
    client().says("limp").leaves()

    assert control.poll() == StopRequest(StopLevel.LIMP, US)
    control.poll()
    control.answer(dict)
    assert control.filenos() == [control.fileno()]


def test_for_who_has_left_no_status_is_made_and_no_order_taken(control, client):
    for word in ("status", "start"):
        client().says(word).leaves()
        control.poll()
    control.attend(lambda _: "")
    control.poll()
    control.answer(lambda: pytest.fail("nobody is there"))

    assert control.take_orders() == []


def test_an_answer_never_reaches_whoever_took_the_place_of_who_asked(control, client):
    """The kernel gives a descriptor that was closed to the next connection."""
    control.poll()
    first = client().says("limp")
    control.poll()
    place = control.filenos()[1]
    first.leaves()
    control.poll()
    second = client()
    control.poll()
    assert control.filenos()[1] == place

    control.answer(dict)
    assert second.heard() == ""


@pytest.mark.parametrize("too_many", [0, 1])
def test_a_word_is_understood_whole_or_refused(tmp_path, too_many):
    word = "set x 1" + " " * (LONGEST_WORD - 7 + too_many)
    with ControlSocket(tmp_path / "face.sock") as control:
        asker = Client(control).says(word)
        control.poll()
        control.answer(dict)
        error = asker.heard()["error"]
        asker.leaves()

    assert (error == f"longer than {LONGEST_WORD} bytes") == bool(too_many)


def test_the_end_is_reported_to_those_who_asked_for_a_stop_and_all_are_let_go(control, client):
    stopping, asking = client().says("soft"), client().says("status")
    control.poll()
    control.answer(dict)
    assert stopping.heard()["accepted"] == "soft"
    assert asking.heard() == {"name": "tom"}
    control.report_end({"confirmed": ["jaw"]})

    assert stopping.heard() == {"ended": True, "name": "tom", "confirmed": ["jaw"]}
    assert [stopping.heard(), asking.heard()] == [None, None]
    assert control.filenos() == [control.fileno()]


def test_who_waits_for_the_end_of_a_stop_stays_where_another_process_takes_over(control, client):
    stopping, idle = client().says("soft"), client()
    for _ in range(2):
        control.poll()
    control.send_away()

    assert idle.heard() is None
    control.report_end({})
    assert stopping.heard() == {"ended": True, "name": "tom"}


def test_orders_are_refused_until_the_loop_takes_them(tmp_path):
    commands = CommandQueue()
    with ControlSocket(tmp_path / "face.sock", {"name": "tom"}, commands) as control:
        asker = Client(control).says("start")
        control.poll()
        control.answer(dict)
        assert "ask again" in asker.heard()["error"]
        control.attend(lambda _: "")
        asker.says("start")
        control.poll()
        assert asker.heard() == ""
        control.answer(dict)

        assert "error" not in asker.heard()
        assert [type(each) for each in control.take_orders()] == [StartFace]
        assert control.take_orders() == []
        asker.leaves()


def test_a_place_that_cannot_be_listened_at_is_named_with_the_reason(tmp_path):
    with pytest.raises(ControlError, match=r"\.sock: cannot listen there: .*too long"):
        ControlSocket(tmp_path / f"{'x' * 120}.sock")
