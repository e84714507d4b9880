"""Clients of the campaign: each requests a stop as it really does."""

import json
import socket
import threading

import pytest
from lipservo_lab.bench.stops.raw_control import request, request_stop
from lipservo_lab.bench.stops.stop_clients import press_stop
from places import short_folder


def served(answers):
    """Serve a control socket; return its path, and a list that grows by what it receives.

    answers: for each connection, the messages that it gets before it is closed.
    """
    path = short_folder() / "face.sock"
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(path))
    listener.listen(8)
    received = []

    def serve():
        for messages in answers:
            end, _ = listener.accept()
            with end:
                received.append(end.recv(100).decode())
                for message in messages:
                    end.send(json.dumps(message).encode())
        listener.close()

    threading.Thread(target=serve, daemon=True).start()
    return path, received


def test_a_stop_that_was_accepted_is_never_sent_again():
    path, received = served([[{"accepted": "limp"}], [{"accepted": "limp"}]])

    assert request_stop(path, "limp", 5.0) == ({"accepted": "limp"}, None)
    assert received == ["limp"]


def test_a_stop_is_sent_again_where_the_connection_ends_without_an_answer():
    path, received = served([[], [{"accepted": "soft"}, {"ended": True}]])

    assert request_stop(path, "soft", 5.0) == ({"accepted": "soft"}, {"ended": True})
    assert received == ["soft", "soft"]


def test_no_answer_is_a_timeout():
    path, _ = served([[]] * 50)

    with pytest.raises(OSError, match="no answer"):
        request(path, "status", 0.2)


class Page:
    """Answers a stop with one HTTP status after another; the one that waits for the end hangs."""

    def __init__(self, *statuses):
        self.statuses = list(statuses)
        self.waited = []
        self.over = threading.Event()

    def post(self, _page, level, wait_s, _timeout_s):
        if wait_s:
            self.waited.append(level)
            self.over.wait(10.0)
            return 200, {}
        status = self.statuses.pop(0)
        if status == 0:
            raise TimeoutError
        return status, {}


@pytest.mark.parametrize(
    ("statuses", "n_requests"), [((200,), 1), ((503, 0, 200), 3), ((403, 200), 0)]
)
def test_the_page_repeats_one_request_until_it_is_accepted_or_refused(statuses, n_requests):
    page = Page(*statuses)

    assert press_stop("http://face", "soft", page.post) == n_requests
    assert page.waited == ["soft"]
    page.over.set()
