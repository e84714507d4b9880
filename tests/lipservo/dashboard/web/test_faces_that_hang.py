"""A face that hangs or is not there: stops come through, and nothing is told as if it were well."""

import contextlib
import socket
import threading
import time

from served_dashboard import served, served_for

from lipsync.errors import UserError


def error_of(answer, status):
    assert answer.status_code == status, answer.text
    return answer.json()["error"]


def test_a_stop_comes_through_while_everything_else_hangs():
    """The face answers no status, and its agent server takes connections and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        agents = f"ws://127.0.0.1:{silent.getsockname()[1]}"
        with served({"listens_on": agents}) as dashboard, dashboard.client() as client:
            answers = []

            def say():
                with contextlib.suppress(Exception), dashboard.client() as other:
                    answers.append(other.post("/api/say", json={"text": "hello"}))

            saying = [threading.Thread(target=say, daemon=True) for _ in range(6)]
            for thread in saying:
                thread.start()
            dashboard.link._command_pool.submit(time.sleep, 3.0)
            dashboard.link._command_pool.submit(time.sleep, 3.0)
            dashboard.link._status_pool.submit(time.sleep, 3.0)
            dashboard.link._find_pool.submit(time.sleep, 3.0)

            told = client.post("/api/stop", json={"level": "limp"}).json()
            assert told["accepted"] == "limp"
            wait_for(lambda: dashboard.face.said == ["limp"])
            assert answers == []


def test_stops_that_wait_for_an_end_hold_no_other_stop_up():
    """The face takes every stop and never comes to its end."""
    with served() as dashboard, dashboard.client() as client:

        def wait_for_the_end():
            with contextlib.suppress(Exception), dashboard.client() as other:
                other.post("/api/stop", json={"level": "soft", "wait_s": 15.0})

        for _ in range(24):
            threading.Thread(target=wait_for_the_end, daemon=True).start()
        wait_for(lambda: "soft" in dashboard.face.said)
        assert client.post("/api/stop", json={"level": "limp"}).json()["accepted"] == "limp"
        wait_for(lambda: "limp" in dashboard.face.said)


def test_a_face_that_hangs_is_told_as_one():
    with served() as dashboard, dashboard.client() as client:
        dashboard.face.answers = False
        assert "hangs" in error_of(client.post("/api/stop"), 503)
        wait_for(lambda: not client.get("/api/health").json()["face_answers"])
        told = client.get("/api/servos").json()
        assert not told["up"]
        assert {each["state"] for each in told["servos"]} == {"unknown"}


def test_no_face_at_all():
    def none():
        raise UserError("no face runs")

    with served_for(none) as dashboard, dashboard.client() as client:
        assert "no face" in error_of(client.post("/api/stop"), 503)
        told = client.get("/api/status").json()
        assert (told["up"], told["age_s"]) == (False, None)
        assert client.get("/api/servos").json()["servos"] == []
        error_of(client.get("/api/calibration"), 409)
        assert "lipservo_up 0.0" in client.get("/metrics").text


def wait_for(condition):
    give_up_s = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        time.sleep(0.02)
