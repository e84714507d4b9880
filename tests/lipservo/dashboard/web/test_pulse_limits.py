"""Limits of hobby servos by the API: who may, what is refused, and two pages that set at once."""

import threading
from contextlib import contextmanager

import pytest
from served_dashboard import served

from firmware_bridge.stopping import JogPulse
from lipservo.settings.settings import load_face

FACE = """\
name: tom # a comment
rate_hz: 50
bus: {kind: maestro, model: micro6}
servos:
  jaw:
    channel: 0
    positive: opens
    min_deg: -9
    max_deg: 9
    max_speed_deg_s: 300
    us_per_deg: 10
    min_us: 1400
    max_us: 1600
"""


@contextmanager
def watched(path, **options):
    status = {"config": str(path), "servos": {"jaw": "driven"}}
    with served(status, **options) as dashboard, dashboard.client() as client:
        yield dashboard, client


@pytest.fixture
def path(tmp_path):
    made = tmp_path / "tom.yaml"
    made.write_text(FACE)
    return made


def limit(client, what, pulse_us, servo="jaw"):
    body = {"servo": servo, "limit": what, "pulse_us": pulse_us}
    return client.post("/api/pulse-limits", json=body)


def test_a_limit_is_written_and_all_of_them_are_answered(path):
    with watched(path) as (_, client):
        answer = limit(client, "max", 1730.0)

    assert answer.status_code == 200
    assert answer.json() == {
        "servo": "jaw",
        "set": {"neutral_us": 1500.0, "us_per_deg": 10.0, "min_us": 1400.0, "max_us": 1730.0,
                "min_deg": -10.0, "max_deg": 23.0},
        "note": "counts from the next start",
    }  # fmt: skip
    assert "# a comment" in path.read_text()
    assert load_face(path).servos["jaw"].max_us == 1730.0


def test_poses_that_await_their_fit_are_forgotten_with_the_neutral_they_were_made_from(path):
    kept = path.with_name("tom.by_eye.json"), path.with_name("tom.measure.json")
    for file in kept:
        file.write_text("{}")
    with watched(path) as (_, client):
        assert limit(client, "max", 1730.0).status_code == 200
        assert all(file.exists() for file in kept)  # their degrees mean what they meant
        assert limit(client, "neutral", 1510.0).status_code == 200

    assert not any(file.exists() for file in kept)


def test_of_two_pages_that_set_at_once_both_are_written(path):
    with watched(path) as (dashboard, client):
        answers = []

        def set_one(what, pulse_us):
            with dashboard.client() as other:
                answers.append(limit(other, what, pulse_us).status_code)

        pages = [
            threading.Thread(target=set_one, args=each)
            for each in (("min", 1300.0), ("max", 1700.0), ("min", 1310.0), ("max", 1690.0))
        ]
        for page in pages:
            page.start()
        for page in pages:
            page.join()
        assert limit(client, "neutral", 1480.0).status_code == 200

    assert answers == [200] * 4
    jaw = load_face(path).servos["jaw"]
    assert jaw.min_us in (1300.0, 1310.0)
    assert jaw.max_us in (1690.0, 1700.0)
    assert jaw.neutral_us == 1480.0


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        ({"servo": "jaw", "limit": "min", "pulse_us": 1550}, 422, "set neutral first"),
        ({"servo": "jaw", "limit": "min", "pulse_us": 400}, 422, "pulse_us"),
        ({"servo": "jaw", "limit": "most", "pulse_us": 1500}, 422, "limit"),
        ({"servo": "lip", "limit": "min", "pulse_us": 1500}, 404, "no servo has that name"),
        ({"limit": "min", "pulse_us": 1500}, 422, "servo"),
        ({"servo": "jaw", "limit": "min", "pulse_us": 1500, "force": True}, 422, "force"),
    ],
)
def test_what_is_refused_is_one_line_and_writes_nothing(path, body, status, words):
    with watched(path) as (_, client):
        answer = client.post("/api/pulse-limits", json=body)

    assert (answer.status_code, words in answer.json()["error"]) == (status, True), answer.text
    assert path.read_text() == FACE


def test_a_shipped_face_and_a_servo_with_an_encoder_have_none_to_set(path):
    with watched("face_jaw_maestro") as (_, client):
        assert "is shipped with lipservo" in limit(client, "min", 1450.0).json()["error"]
    path.write_text(
        "name: t\nrate_hz: 50\nservos: {jaw: {id: 1, model: XL330-M288, positive: opens, "
        "min_deg: 0, max_deg: 9, max_speed_deg_s: 300}}\n"
    )
    with watched(path) as (_, client):
        assert "no hobby servo is called 'jaw'" in limit(client, "min", 1450.0).json()["error"]


def test_a_limit_and_a_move_need_the_token(path):
    with watched(path, token="secret") as (_, client):
        move = {"action": "move", "servo": "jaw", "pulse_us": 1500}
        assert limit(client, "max", 1700.0).status_code == 401
        assert client.post("/api/jog", json=move).status_code == 401
    assert path.read_text() == FACE


def test_a_move_by_its_pulse_reaches_the_face_and_needs_one_place(path):
    with watched(path) as (dashboard, client):
        orders = []
        dashboard.face.commands.attend(lambda order: orders.append(order) or "")
        move = {"action": "move", "servo": "jaw", "pulse_us": 1512.0}
        assert client.post("/api/jog", json=move).status_code == 200
        for wrong in ({"deg": 3.0}, {"pulse_us": 2501.0}, {"pulse_us": None}):
            assert client.post("/api/jog", json=move | wrong).status_code == 422

    assert orders == [JogPulse("jaw", 1512.0)]
