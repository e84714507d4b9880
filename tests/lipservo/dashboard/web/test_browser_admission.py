"""The door of the dashboard: what may come in and what is turned away, with a token and without."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipservo.dashboard.web.browser_admission import (
    Asked,
    Refused,
    SentOn,
    cookie_of,
    judged,
    most_bytes,
)

HOST = "127.0.0.1:8080"
TOKEN = "a secret"
OF_ITS_PAGE = {"origin": f"http://{HOST}", "sec-fetch-site": "same-origin"}
FOREIGN = {"origin": "http://evil.example", "sec-fetch-site": "cross-site"}
A_LINK = {
    "sec-fetch-site": "cross-site",
    "sec-fetch-mode": "navigate",
    "sec-fetch-dest": "document",
}


def asked(path="/", method="GET", query="", is_socket=False, **headers):
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return Asked(method, path, query, {"host": HOST, **named}, is_socket)


def with_headers(given, **about):
    return asked(**about, **{name.replace("-", "_"): value for name, value in given.items()})


@pytest.mark.parametrize(
    "host", [HOST, "localhost:8080", "[::1]:8080", "192.168.1.7", "10.0.0.2:1"]
)
def test_without_a_token_addresses_are_let_in(host):
    assert judged(asked(host=host), None) is None


@pytest.mark.parametrize("host", ["evil.example", "robot.local:8080", "", "127.0.0.1.evil.example"])
def test_without_a_token_no_name_is_let_in_that_a_page_may_turn(host):
    assert judged(asked(host=host), None).status == 403


def test_with_a_token_any_name_will_do():
    assert judged(asked(host="robot.local", authorization=f"Bearer {TOKEN}"), TOKEN) is None


@pytest.mark.parametrize("token", [None, TOKEN])
@pytest.mark.parametrize(
    "about",
    [
        {"path": "/api/stop", "method": "POST"},
        {"path": "/api/status"},
        {"path": "/api/twin", "is_socket": True},
        {"path": "/_nicegui_ws/socket.io/", "is_socket": True},
        {"path": "/_nicegui_ws/socket.io/"},
        {"path": "/_nicegui_ws/socket.io/", "method": "POST"},
        {"path": "/_nicegui/client/1/upload/2", "method": "POST"},
        {"path": "/"},
        {"path": "/metrics"},
    ],
    ids=lambda about: about["path"] + (" socket" if about.get("is_socket") else ""),
)
@pytest.mark.parametrize(
    "headers",
    [
        FOREIGN,
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
        {"origin": "https://localhost:8080"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"origin": "http://[", "sec-fetch-site": "same-origin"},
        {"origin": f"file://{HOST}"},
    ],
    ids=str,
)
def test_scripts_of_other_pages_are_turned_away_wherever_they_knock(headers, about, token):
    given = {**headers, "authorization": f"Bearer {TOKEN}"}
    verdict = judged(with_headers(given, **about), token)

    assert isinstance(verdict, Refused)
    assert verdict.status == 403


@pytest.mark.parametrize("headers", [OF_ITS_PAGE, {}, {"sec-fetch-site": "none"}], ids=str)
@pytest.mark.parametrize("path", ["/", "/api/stop", "/_nicegui_ws/socket.io/"])
def test_its_own_pages_programs_and_people_are_let_in(path, headers):
    for method in ("GET", "POST"):
        assert judged(with_headers(headers, path=path, method=method), None) is None


def test_a_link_in_another_page_may_lead_to_a_page_and_to_nothing_else():
    assert judged(with_headers(A_LINK, path="/servos"), None) is None
    for about in ({"path": "/api/status"}, {"path": "/", "method": "POST"}, {"path": "/metrics"}):
        assert judged(with_headers(A_LINK, **about), None).status == 403
    framed = {**A_LINK, "sec-fetch-dest": "iframe"}
    assert judged(with_headers(framed, path="/"), None).status == 403


@pytest.mark.parametrize("is_socket", [False, True])
@pytest.mark.parametrize(
    "given",
    [
        {},
        {"authorization": "Bearer wrong"},
        {"authorization": f"Basic {TOKEN}"},
        {"authorization": "Bearer "},
        {"query": "token=wrong"},
        {"query": "token="},
        {"cookie": f"lipservo={TOKEN}"},
        {"cookie": f"{cookie_of(TOKEN)[0]}=0"},
        {"cookie": f"{cookie_of('other')[0]}={cookie_of('other')[1]}"},
        {"authorization": "Bearer \udcff"},
    ],
    ids=str,
)
def test_without_the_token_nobody_comes_in(given, is_socket):
    for path in ("/", "/api/status", "/metrics", "/static/frame.js", "/_nicegui_ws/socket.io/"):
        assert judged(asked(path, is_socket=is_socket, **given), TOKEN).status == 401


def test_the_token_comes_by_header_by_cookie_or_by_the_query():
    name, value = cookie_of(TOKEN)
    assert judged(asked("/api/status", authorization=f"Bearer {TOKEN}"), TOKEN) is None
    assert judged(asked("/api/status", cookie=f"a=b; {name}={value}"), TOKEN) is None
    assert judged(asked("/api/twin", query="token=a+secret", is_socket=True), TOKEN) is None


def test_a_page_asked_for_with_the_token_becomes_a_cookie_that_does_not_tell_it():
    verdict = judged(asked("/servos", query="a=1&token=a%20secret&b=2"), TOKEN)

    assert isinstance(verdict, SentOn)
    assert verdict.location == "/servos?a=1&b=2"
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(verdict.cookie.split("; "))
    assert TOKEN not in verdict.cookie
    cookie = verdict.cookie.split(";")[0]
    assert judged(asked("/servos", cookie=cookie), TOKEN) is None


@pytest.mark.parametrize("path", ["//evil.example/", "/\\evil.example", "/\\/evil.example"])
def test_nobody_is_sent_on_to_another_host(path):
    verdict = judged(asked(path, query="token=a+secret"), TOKEN)
    assert verdict.location == "/evil.example/" or verdict.location == "/evil.example"


@given(
    st.sampled_from([None, TOKEN]),
    st.text(max_size=40),
    st.dictionaries(
        st.sampled_from(["host", "origin", "cookie", "authorization", "sec-fetch-site"]),
        st.text(max_size=40),
    ),
    st.booleans(),
)
def test_whatever_comes_is_judged_and_only_the_token_opens(token, query, headers, is_socket):
    request = Asked("GET", "/api/status", query, {"host": HOST, **headers}, is_socket)
    try:
        verdict = judged(request, token)
    except ValueError:  # the door answers 400
        return
    assert verdict is None or isinstance(verdict, Refused)
    if token is not None:
        assert isinstance(verdict, Refused)


def test_only_files_may_be_long():
    assert most_bytes("/api/lines") > 50_000_000
    assert most_bytes("/api/stop") == most_bytes("/") == 1 << 20
