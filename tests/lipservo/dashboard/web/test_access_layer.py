"""What a browser meets: the token's redirect, a code that works once, STOP without the token."""

import os

import pytest
from served_dashboard import served, wait_for

from lipservo.dashboard.web import access_layer
from lipservo.dashboard.web.access_layer import OneTimeCode, most_bytes, stop_page

TOKEN = "a secret"
A_PAGE = {"accept": "text/html,application/xhtml+xml"}


@pytest.fixture(scope="module")
def code():
    return OneTimeCode(os.geteuid())


@pytest.fixture(scope="module")
def dashboard(code):
    with served({"config": "face_sim"}, token=TOKEN, code=code) as made:
        yield made


@pytest.fixture
def client(dashboard):
    with dashboard.client() as made:
        yield made


def test_the_token_of_an_address_becomes_a_cookie_and_opens_what_follows(client):
    answer = client.get("/docs", params={"token": TOKEN})
    assert (answer.status_code, answer.headers["location"]) == (303, "/docs")
    assert TOKEN not in str(answer.headers)
    assert client.get("/docs").status_code == 200


@pytest.mark.parametrize("given", ["", "wrong", "a secret ", "an old one"])
def test_another_token_opens_nothing(client, given):
    assert client.get("/docs", params={"token": given}).status_code == 401
    assert client.cookies == {}


def test_a_code_opens_the_page_of_this_user_once(dashboard, code):
    with dashboard.client() as browser:
        assert browser.get("/docs", params={"token": code.code}).status_code == 303
        assert browser.get("/docs").status_code == 200
    with dashboard.client() as late:
        assert late.get("/docs", params={"token": code.code}).status_code == 401


def test_a_code_is_no_token():
    fresh = OneTimeCode(os.geteuid())
    with served({}, token=TOKEN, code=fresh) as other, other.client() as client:
        in_query = {"params": {"token": fresh.code}}
        in_header = {"headers": {"authorization": f"Bearer {fresh.code}"}}
        of_a_script = {**in_query, "headers": {"origin": "http://localhost:3000"}}
        assert client.get("/api/status", **in_query).status_code == 401
        assert client.get("/docs", **in_header).status_code == 401
        assert client.get("/docs", **of_a_script).status_code == 403
        assert client.post("/docs", **in_query).status_code == 401
        assert client.get("/docs", **in_query).status_code == 303


def test_a_code_works_for_no_other_user(monkeypatch):
    fresh = OneTimeCode(os.geteuid())
    monkeypatch.setattr(access_layer, "connected_users", lambda *_ports: {os.geteuid() + 1})
    assert not fresh.admits(fresh.code, 50_000, 8080)
    monkeypatch.setattr(access_layer, "connected_users", lambda *_ports: {os.geteuid()})
    assert not fresh.admits("another", 50_000, 8080)
    assert fresh.admits(fresh.code, 50_000, 8080)
    assert not fresh.admits(fresh.code, 50_000, 8080)


def test_a_browser_here_without_the_token_gets_a_page_with_stop(client, dashboard):
    answer = client.get("/servos", headers=A_PAGE)

    assert answer.status_code == 401
    assert answer.headers["content-type"].startswith("text/html")
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert 'id="face-stop"' in answer.text
    assert "lipservo dashboard --open" in answer.text
    assert "/static/" not in answer.text  # nothing more is served without the token
    dashboard.face.said.clear()
    assert client.post("/api/stop", json={"level": "soft", "wait_s": 0}).status_code == 200
    wait_for(lambda: dashboard.face.said == ["soft"])


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/api/status", A_PAGE),
        ("/static/frame.js", A_PAGE),
        ("/", {}),
        ("/", {**A_PAGE, "host": "robot.local"}),
        ("/", {**A_PAGE, "x-forwarded-for": "192.0.2.7"}),
        ("/", {**A_PAGE, "origin": "http://localhost:3000"}),
    ],
)
def test_that_page_is_for_people_here_alone(client, path, headers):
    answer = client.get(path, headers=headers)
    assert answer.status_code in (401, 403)
    assert list(answer.json()) == ["error"]


def test_the_script_of_stop_can_stand_in_a_page():
    """It imports nothing, and nothing in it ends the page's script element."""
    page = stop_page()
    assert page.count("</script") == 1
    assert "import " not in page.partition('<script type="module">')[2].partition("\n")[0]


def test_a_listed_page_may_ask_and_reads_the_answers(dashboard, client):
    dashboard.link.origins = ("https://kiosk.example",)
    page = {"origin": "https://kiosk.example", "sec-fetch-site": "cross-site"}
    try:
        preflight = client.options("/api/say", headers=page)
        assert preflight.status_code == 204
        assert "authorization" in preflight.headers["access-control-allow-headers"]
        assert client.get("/api/status", headers=page).status_code == 401
        bearer = {**page, "authorization": f"Bearer {TOKEN}"}
        for answer in (
            client.get("/api/status", headers=bearer),
            client.post("/api/stop", headers=bearer),
        ):
            assert answer.status_code == 200
            assert answer.headers["access-control-allow-origin"] == "https://kiosk.example"
        assert (
            client.options("/api/say", headers={"origin": "http://evil.example"}).status_code == 403
        )
    finally:
        dashboard.link.origins = ()


def test_the_origins_are_those_of_the_faces_yaml(tmp_path):
    yaml = tmp_path / "tom.yaml"
    yaml.write_text(
        "name: tom\nrate_hz: 100.0\naccess: {origins: ['https://kiosk.example']}\nservos:\n"
        "  jaw: {id: 11, model: XL330-M288, positive: opens, min_deg: -2, max_deg: 25, "
        "max_speed_deg_s: 300}\n"
    )
    with served({"config": str(yaml)}) as made:
        assert made.link.origins == ("https://kiosk.example",)


def test_only_files_may_be_long():
    assert most_bytes("/api/lines") > 50_000_000
    assert most_bytes("/api/stop") == most_bytes("/") == 1 << 20
