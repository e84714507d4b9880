"""What a stop passes on its way to the command queue: counted by a tracer, held by two bars."""

import importlib.util
import socket
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from lipservo_lab.bench.stops import traced as tracer_module
from lipservo_lab.bench.stops.raw_control import request
from lipservo_lab.bench.stops.running_face import running_face
from lipservo_lab.bench.stops.stop_clients import post_stop, stop_by_control
from lipservo_lab.bench.stops.stop_path import TIMEOUT_S, counted, traced_stop
from lipservo_lab.bench.stops.traced import MARKER, StopTracer, has_marker

#: Bars: one file is the room that is kept for stops beside idle connections.
MOST_FILES, MOST_CALLS = 7, 40

#: A program in small: a server that gives a stop to a thread, and the owner of a command queue.
PROGRAM = """
class CommandQueue:
    def stop(self, level):
        after()

def serve(request, pool, end):
    checked(request)
    return pool.submit(tell, end).result()

def checked(request):
    return [len(each) for each in request]

def tell(end):
    end.send(b"limp")
    after()

def after():
    pass

def own(end, queue):
    level = end.recv(100)
    described()
    queue.stop(level)

def described():
    pass
"""


@pytest.fixture
def program(tmp_path):
    """Return the text PROGRAM as a loaded module, in a package `lipservo` below `tmp_path`."""
    (tmp_path / "lipservo").mkdir()
    path = tmp_path / "lipservo" / "small_program.py"
    path.write_text(PROGRAM)
    spec = importlib.util.spec_from_file_location("small_program", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def traced(tmp_path):
    """Trace this thread and those that it starts; yield the tracer and the walks that it finds."""
    walks = []
    tracer = StopTracer(str(tmp_path), walks.append, lambda _walk: None)
    tracer.is_on = True
    before = sys.getprofile()
    threading.setprofile(tracer.profile)
    sys.setprofile(tracer.profile)
    yield tracer, walks
    sys.setprofile(before)
    threading.setprofile(before)


class TracedPool(ThreadPoolExecutor):
    """As `install` makes every executor of a process."""

    def __init__(self, tracer):
        super().__init__(1)
        self.tracer = tracer

    def submit(self, function, /, *arguments):
        return super().submit(self.tracer.submitted(function), *arguments)


def functions(walk):
    return [function for _, function in walk.calls]


def test_a_walk_goes_from_the_function_that_gets_the_request_into_threads_to_the_sending(
    program, traced
):
    tracer, walks = traced
    ours, theirs = socket.socketpair()
    with TracedPool(tracer) as pool, ours, theirs:
        program.checked("another request")
        program.serve((b"POST", MARKER.encode()), pool, ours)
        program.after()

    [walk] = walks
    assert functions(walk) == ["serve", "checked", "checked.<locals>.<listcomp>", "tell"]
    assert {file for file, _ in walk.calls} == {"lipservo/small_program.py"}


def test_at_the_owner_a_walk_goes_from_the_receiving_function_to_the_queue(program, traced):
    tracer, walks = traced

    class Received:
        def recv(self, _n):
            tracer.received(b"limp", sys._getframe(1))
            return b"limp"

    program.described()
    program.own(Received(), program.CommandQueue())
    program.described()

    [walk] = walks
    assert functions(walk) == ["own", "described", "CommandQueue.stop"]


def test_nothing_is_counted_while_it_is_off(program, traced):
    tracer, walks = traced
    tracer.is_on = False
    ours, theirs = socket.socketpair()
    with TracedPool(tracer) as pool, ours, theirs:
        program.serve((MARKER,), pool, ours)

    assert walks == []


def test_the_marker_is_found_in_what_a_server_hands_on():
    scope = {"type": "http", "headers": [(b"host", b"x"), (b"user-agent", MARKER.encode())]}

    assert has_marker((scope, None, None))
    assert has_marker(f'{{"id": "{MARKER}"}}')
    assert not has_marker(({"headers": [(b"host", b"x")]}, 3, object()))


def test_the_files_of_all_processes_are_counted_once_and_the_calls_each_time():
    server = {"role": "dashboard", "calls": [["a.py", "one"], ["b.py", "two"], ["a.py", "one"]]}
    owner = {"role": "bridge-process", "calls": [["b.py", "three"], ["c.py", "CommandQueue.stop"]]}

    found = counted([server, owner])

    assert (found["files"], found["calls"]) == (3, 5)
    assert found["walk"]["bridge-process"] == ["b.py:three", "c.py:CommandQueue.stop"]


@pytest.mark.slow
def test_a_stop_passes_few_files_and_calls_of_ours_until_it_is_in_the_queue():
    with running_face(page=True, agents=True, tracer=tracer_module) as face:
        at = face.at
        clients = {
            "socket": lambda: request(at.control, "freeze", TIMEOUT_S),
            "page": lambda: post_stop(at.page, "freeze", 0, TIMEOUT_S, MARKER),
            "api": lambda: post_stop(at.page, "freeze", 1, TIMEOUT_S, MARKER),
            "control": lambda: stop_by_control(at.agents, "freeze", TIMEOUT_S, MARKER),
        }
        found = {name: traced_stop(face, stop) for name, stop in clients.items()}

    assert max(each["files"] for each in found.values()) <= MOST_FILES, found
    assert max(each["calls"] for each in found.values()) <= MOST_CALLS, found
