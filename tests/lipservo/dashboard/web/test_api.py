"""The API over real HTTP, to a face that answers by its real control socket."""

import contextlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from served_dashboard import served, wait_for
from voice_agents.served_face import ServedFace
from watched_face import SERVOS
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

HEALTH = [
    {"name": "jaw", "servo_id": 11, "state": "driven", "temperature_degc": 41.0, "load": 0.2,
     "voltage_v": 5.1, "current_ma": None, "hardware_errors": 0, "n_reboots": 0,
     "n_unanswered": 3, "torque_on": True},
    {"name": "neck", "servo_id": 12, "state": "failed", "temperature_degc": 80.0, "load": 0.9,
     "voltage_v": 5.0, "current_ma": None, "hardware_errors": 0x24, "n_reboots": 3,
     "n_unanswered": 0, "torque_on": False},
    {"name": "cheek_left", "servo_id": 13, "state": "waiting", "temperature_degc": None,
     "load": None, "voltage_v": None, "current_ma": None, "hardware_errors": None,
     "n_reboots": 0, "n_unanswered": 90, "torque_on": None},
]  # fmt: skip


@pytest.fixture(scope="module")
def dashboard():
    with served({"health": HEALTH, "troubles": ["neck: too hot"], "config": "face_sim"}) as made:
        yield made


@pytest.fixture
def client(dashboard):
    with dashboard.client() as made:
        yield made


def error_of(answer, status):
    assert answer.status_code == status, answer.text
    assert list(answer.json()) == ["error"]
    assert len(answer.json()["error"].splitlines()) == 1
    return answer.json()["error"]


def test_the_status_is_the_faces_own_and_says_how_sure_it_is(client):
    told = client.get("/api/status").json()

    assert (told["name"], told["state"]) == ("tom", "driven")
    assert told["face_answers"]
    assert told["up"]
    assert told["age_s"] < 2.0


@pytest.mark.parametrize("level", ["soft", "freeze", "limp"])
def test_a_stop_reaches_the_face(client, dashboard, level):
    dashboard.face.said.clear()
    told = client.post("/api/stop", json={"level": level}).json()
    assert told == {"accepted": level}
    wait_for(lambda: dashboard.face.said == [level])


def test_a_stop_may_wait_for_what_the_servos_confirm(client, dashboard):
    confirmed = {"complete": True, "confirmed": ["jaw"], "unconfirmed": {}}
    dashboard.face.report = confirmed

    told = client.post("/api/stop", json={"level": "limp", "wait_s": 5.0}).json()

    assert told["accepted"] == "limp"
    assert told["report"].items() >= confirmed.items()


def test_a_stop_whose_end_does_not_come_claims_nothing(client):
    told = client.post("/api/stop", json={"wait_s": 0.2}).json()

    assert told == {"accepted": "soft", "report": None}


def test_a_face_without_a_voice_cannot_be_silenced(client):
    answer = client.post("/api/interrupt")

    assert answer.status_code == 409
    assert "takes no speech" in answer.json()["error"]


def test_an_interruption_claims_no_silence_since_an_agent_may_speak_on():
    with (
        ServedFace() as voice,
        served({"listens_on": voice.url}) as dashboard,
        dashboard.client() as client,
    ):
        told = client.post("/api/interrupt").json()

    assert told == {"accepted": "interrupt"}


def test_a_stop_needs_no_body(client, dashboard):
    dashboard.face.said.clear()
    assert client.post("/api/stop").json()["accepted"] == "soft"
    wait_for(lambda: dashboard.face.said == ["soft"])


def test_settings_change_together_or_not_at_all(client, dashboard):
    values = dashboard.face.commands
    assert client.patch("/api/settings", json={"values": {"strength": 0.75}}).status_code == 200
    assert values.values["strength"] == 0.75

    answer = client.patch("/api/settings", json={"values": {"strength": 9}})
    assert "0 to 1.5" in error_of(answer, 422)
    assert values.values["strength"] == 0.75


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/api/look-at", {"yaw_deg": 61.0}),
        ("/api/look-at", {"yaw_deg": "left"}),
        ("/api/look-at", {"pitch_deg": 1.0}),
        ("/api/affect", {"valence": 2.0, "arousal": 0.0}),
        ("/api/affect", {"valence": 0.0, "arousal": 0.0, "tau_s": 0.0}),
        ("/api/jog", {"action": "move", "servo": "jaw", "deg": 181.0}),
        ("/api/jog", {"action": "move"}),
        ("/api/jog", {"action": "fly"}),
        ("/api/servos/jaw", {"action": "explode"}),
        ("/api/stop", {"level": "sudden"}),
        ("/api/stop", {"level": "soft", "twice": True}),
        ("/api/say", {"text": ""}),
        ("/api/say", {"text": "a" * 20_001}),
        ("/api/say", {"text": "a", "rate_wpm": 9000}),
        ("/api/say", {"text": "a", "pitch": -1}),
        ("/api/play", {"file": "../../etc/passwd"}),
        ("/api/play", {"file": "/etc/passwd"}),
        ("/api/play", {"file": "a.txt"}),
    ],
    ids=str,
)
def test_what_is_outside_its_limits_is_refused_and_nothing_is_sent(client, dashboard, path, body):
    dashboard.face.said.clear()
    before = dashboard.face.commands.values

    error_of(client.post(path, json=body), 422)

    assert dashboard.face.said == []
    assert dashboard.face.commands.values == before


@pytest.mark.parametrize("name", ["nobody", "jaw off", "jaw\noff", "%00", "😀", "a" * 500])
def test_unknown_servos_are_refused(client, name):
    error_of(client.post(f"/api/servos/{name}".replace("\n", "%0A"), json={"action": "off"}), 404)
    answer = client.post("/api/jog", json={"action": "move", "servo": name[:64], "deg": 1.0})
    error_of(answer, 404)


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/api/nothing", 404),
        ("GET", "/api", 404),
        ("DELETE", "/api/status", 405),
        ("GET", "/api/stop", 405),
        ("GET", "/static/../../../pyproject.toml", 404),
        ("GET", "/static/%2e%2e/%2e%2e/face_link.py", 404),
        ("GET", "/static/nothing.js", 404),
    ],
)
def test_errors_of_every_kind_are_json(client, method, path, status):
    error_of(client.request(method, path), status)


@pytest.mark.parametrize(
    "body", [b"", b"{", b"[]", b"null", b'"stop"', b"\xff\xfe", b"{" * 5000, b'{"text": NaN}']
)
def test_bodies_that_are_none_are_told(client, body):
    answer = client.post("/api/say", content=body, headers={"content-type": "application/json"})
    assert answer.status_code in (400, 422)
    error_of(answer, answer.status_code)


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(
    st.sampled_from(["/api/stop", "/api/say", "/api/jog", "/api/look-at", "/api/affect",
                     "/api/servos/jaw", "/api/play"]),
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
        lambda inner: st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["level", "text", "action", "servo", "deg", "yaw_deg", "values"])
            | st.text(max_size=5),
            inner,
            max_size=4,
        ),
        max_leaves=6,
    ),
)  # fmt: skip
def test_whatever_json_comes_the_answer_is_json(client, path, body):
    import json

    content = json.dumps(body).encode("utf-8", "surrogatepass")
    answer = client.post(path, content=content, headers={"content-type": "application/json"})
    assert answer.status_code < 500 or answer.status_code == 503
    assert isinstance(answer.json(), dict)


def test_a_long_body_is_not_read(client):
    error_of(client.post("/api/say", json={"text": "a" * 2_000_000}), 413)

    def endless():
        for _ in range(64):
            yield b"a" * 65_536

    with contextlib.suppress(OSError):
        error_of(client.post("/api/say", content=endless()), 413)
    assert client.get("/api/health").status_code == 200


def test_servos_are_told_with_plain_words_and_what_to_do(client):
    told = {each["name"]: each for each in client.get("/api/servos").json()["servos"]}

    assert set(told) == {*SERVOS}
    assert told["jaw"]["answers"]
    assert told["jaw"]["errors"] == []
    assert {each["error"] for each in told["neck"]["errors"]} == {"overheating", "overload"}
    assert all(each["remedy"] for each in told["neck"]["errors"])
    assert "binds" in told["neck"]["trouble"]["remedy"]
    assert not told["cheek_left"]["answers"]
    assert not told["upper_lip_left"]["answers"]
    assert told["upper_lip_left"]["temperature_degc"] is None


def test_faults_and_calibration(client):
    faults = client.get("/api/faults").json()
    assert faults["troubles"] == ["neck: too hot"]
    told = client.get("/api/calibration").json()
    assert told["fits_the_face"]
    assert {"servos", "coverage", "trim", "hold_out"} <= set(told)


def test_a_shipped_face_is_not_written_and_says_what_to_do(client):
    told = client.get("/api/settings").json()
    assert not told["can_save"]
    answer = client.patch("/api/settings", json={"values": {"strength": 0.5}, "save": True})
    assert "new-face" in error_of(answer, 422)


def test_without_a_voice_it_says_so(client):
    assert "daemon" in error_of(client.post("/api/say", json={"text": "hello"}), 409)


def test_the_description_works_offline(client):
    page = client.get("/docs").text
    paths = client.get("/openapi.json").json()["paths"]

    assert "/api/stop" in paths
    assert all(path in page for path in paths)
    assert "http://" not in page
    assert "https://" not in page
    assert "<script" not in page


def test_static_files_are_asked_for_again_and_sent_once(client):
    first = client.get("/static/frame.js")
    assert first.headers["cache-control"] == "no-cache"
    assert first.headers["content-type"].startswith("text/javascript")
    again = client.get("/static/frame.js", headers={"if-none-match": first.headers["etag"]})
    assert again.status_code == 304


def test_every_answer_forbids_frames_and_other_hosts(client):
    for path in ("/api/status", "/docs", "/static/frame.js", "/api/nothing"):
        headers = client.get(path).headers
        assert "default-src 'self'" in headers["content-security-policy"]
        assert headers["x-frame-options"] == "DENY"
        assert headers["x-content-type-options"] == "nosniff"


def test_the_policy_is_before_the_api(client):
    assert client.get("/api/status", headers={"host": "evil.example"}).status_code == 403
    foreign = {"origin": "http://evil.example"}
    assert "not admitted" in error_of(client.post("/api/stop", headers=foreign), 403)


def test_history_is_the_last_frames(client, dashboard):
    wait_for(lambda: len(dashboard.link.history) > 3)
    raw = client.get("/api/history").content
    at, numbers = 0, []
    while at < len(raw):
        length = int.from_bytes(raw[at : at + 2], "little")
        numbers.append(int.from_bytes(raw[at + 2 : at + 6], "little"))
        at += 2 + length
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_with_a_token_nothing_but_a_stop_is_done_without_it():
    with served(token="a secret") as dashboard, dashboard.client() as client:
        for path in ("/api/status", "/metrics", "/docs", "/static/frame.js", "/openapi.json"):
            error_of(client.get(path), 401)
            with pytest.raises(InvalidStatus), connect(dashboard.streams + "/api/twin", proxy=None):
                pass
        error_of(client.post("/api/start"), 401)
        error_of(client.post("/api/jog", json={"action": "arm"}), 401)
        error_of(client.post("/api/stop", json={"end": True}), 401)
        error_of(client.post("/api/stop", json={"level": "limp"}, headers={"via": "1.1 x"}), 401)
        assert dashboard.face.said == []
        for headers in ({}, {"authorization": "Bearer an old one"}):
            assert client.post("/api/stop", headers=headers).json() == {"accepted": "soft"}
        wait_for(lambda: dashboard.face.said == ["soft", "soft"])
        bearer = {"authorization": "Bearer a secret"}
        assert client.get("/api/status", headers=bearer).status_code == 200
        sent_on = client.get("/docs?token=a%20secret")
        assert (sent_on.status_code, sent_on.headers["location"]) == (303, "/docs")
        assert client.get("/docs").status_code == 200  # by the cookie
