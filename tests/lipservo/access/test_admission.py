"""Who may connect: what one policy admits and refuses, with a token and without."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipservo.access.admission import (
    Policy,
    Redirect,
    Refusal,
    Request,
    cookie_of,
    redirect_to_cookie,
    refusal,
)

HOST = "127.0.0.1:8080"
TOKEN = "a secret"
OF_ITS_PAGE = {"origin": f"http://{HOST}", "sec-fetch-site": "same-origin"}
FOREIGN = {"origin": "http://evil.example", "sec-fetch-site": "cross-site"}
A_LINK = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
A_LINK["sec-fetch-dest"] = "document"
HERE, ELSEWHERE = "127.0.0.1", "192.0.2.7"


def request(path="/", method="GET", query="", is_socket=False, peer=HERE, **headers):
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return Request(method, path, query, {"host": HOST, **named}, is_socket, peer)


def with_headers(given, **about):
    return request(**about, **{name.replace("-", "_"): value for name, value in given.items()})


def status(given, token=TOKEN, **how):
    """Of the refusal; None: admitted."""
    refused = refusal(given, Policy(token), **how)
    return None if refused is None else int(refused.status)


def test_without_a_token_addresses_are_admitted_and_no_name_that_a_page_may_turn():
    for host in (HOST, "localhost:8080", "[::1]:8080", "192.168.1.7", "10.0.0.2:1"):
        assert status(request(host=host), None) is None, host
    for host in ("evil.example", "robot.local:8080", "", "127.0.0.1.evil.example"):
        assert status(request(host=host), None) == 403, host
        assert status(request("/api/stop", "POST", host=host), is_stop=True) == 403, host
    assert status(request(host="robot.local", authorization=f"Bearer {TOKEN}")) is None


OF_OTHER_PAGES = [
    FOREIGN,
    {"origin": "http://evil.example"},
    {"origin": "null"},
    {"origin": ""},
    {"origin": "http://127.0.0.1:9999"},
    {"origin": "http://localhost:3000"},
    {"origin": "http://[::1]:8080"},
    {"origin": "https://localhost:8080"},
    {"origin": f"http://{HOST}.evil.example"},
    {"sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "same-site"},
    {"origin": "http://[", "sec-fetch-site": "same-origin"},
    {"origin": f"file://{HOST}"},
]


SOCKETS = ["/api/twin", "/stream", "/control", "/_nicegui_ws/socket.io/"]
POSTS = ["/api/stop", "/_nicegui_ws/socket.io/", "/_nicegui/client/1/upload/2"]
GETS = ["/api/status", "/_nicegui_ws/socket.io/", "/", "/metrics"]


@pytest.mark.parametrize(
    ("path", "how"),
    [
        *((path, {"is_socket": True}) for path in SOCKETS),
        *((path, {"method": "POST"}) for path in POSTS),
        *((path, {}) for path in GETS),
    ],
    ids=str,
)
def test_scripts_of_other_pages_are_refused_everywhere(path, how):
    """Those of other ports of this computer too, and whatever they know."""
    about = {"path": path, **how}
    for headers, token in product(OF_OTHER_PAGES, (None, TOKEN)):
        given = {**headers, "authorization": f"Bearer {TOKEN}"}
        assert status(with_headers(given, **about), token) == 403, (headers, token)
        assert status(with_headers(given, **about), token, is_stop=True) == 403, (headers, token)


@pytest.mark.parametrize("headers", [OF_ITS_PAGE, {}, {"sec-fetch-site": "none"}], ids=str)
@pytest.mark.parametrize("path", ["/", "/api/stop", "/_nicegui_ws/socket.io/", "/stream"])
def test_its_own_pages_programs_and_people_are_admitted(path, headers):
    for method in ("GET", "POST"):
        assert status(with_headers(headers, path=path, method=method), None) is None


def test_listed_origins_are_admitted_and_need_the_token_as_everything_does():
    policy = Policy(TOKEN, ("https://kiosk.example", "http://localhost:3000"))
    for origin in policy.origins:
        page = {"origin": origin, "sec-fetch-site": "cross-site"}
        assert refusal(with_headers(page, path="/stream", is_socket=True), policy).status == 401
        page["authorization"] = f"Bearer {TOKEN}"
        assert refusal(with_headers(page, path="/stream", is_socket=True), policy) is None
    for origin in ("https://kiosk.example.evil.example", "http://kiosk.example", ""):
        page = {"origin": origin, "authorization": f"Bearer {TOKEN}"}
        assert refusal(with_headers(page, path="/stream", is_socket=True), policy).status == 403


def test_a_link_in_another_page_may_lead_to_a_page_and_to_nothing_else():
    assert status(with_headers(A_LINK, path="/servos"), None) is None
    for about in ({"path": "/api/status"}, {"path": "/", "method": "POST"}, {"path": "/metrics"}):
        assert status(with_headers(A_LINK, **about), None) == 403
    framed = {**A_LINK, "sec-fetch-dest": "iframe"}
    assert status(with_headers(framed, path="/"), None) == 403


WITHOUT = [
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
]


@pytest.mark.parametrize("given", WITHOUT, ids=str)
def test_without_the_token_nothing_is_admitted_on_this_computer_or_elsewhere(given):
    peers = (HERE, "::1", "::ffff:127.0.0.1", ELSEWHERE, "")
    paths = ("/", "/api/status", "/metrics", "/static/frame.js", "/stream", "/control", "/docs")
    for peer, is_socket, path in product(peers, (False, True), paths):
        asked = request(path, is_socket=is_socket, peer=peer, **given)
        assert status(asked) == 401, asked


@pytest.mark.parametrize("given", WITHOUT, ids=str)
def test_a_stop_needs_no_token_on_this_computer_and_does_elsewhere(given):
    """A wrong or old token is no worse than none."""
    for peer in (HERE, "127.8.8.8", "::1", "::ffff:127.0.0.1"):
        assert status(request("/api/stop", "POST", peer=peer, **given), is_stop=True) is None
    for peer in (ELSEWHERE, "::ffff:192.0.2.7", "2001:db8::1", ""):
        assert status(request("/api/stop", "POST", peer=peer, **given), is_stop=True) == 401
    right = {"authorization": f"Bearer {TOKEN}"}
    assert status(request("/api/stop", "POST", peer=ELSEWHERE, **right), is_stop=True) is None


@pytest.mark.parametrize("header", ["forwarded", "via", "x-forwarded-for", "x-real-ip"])
def test_what_a_proxy_hands_on_is_not_from_this_computer(header):
    handed_on = request("/api/stop", "POST", **{header.replace("-", "_"): "192.0.2.7"})
    assert status(handed_on, is_stop=True) == 401
    assert status(handed_on, None) == 401


def test_the_token_comes_by_header_by_cookie_or_by_the_query():
    name, value = cookie_of(TOKEN)
    for peer in (HERE, ELSEWHERE):
        by_header = request("/api/status", authorization=f"Bearer {TOKEN}", peer=peer)
        by_cookie = request("/api/status", cookie=f"a=b; {name}={value}", peer=peer)
        by_query = request("/api/twin", query="token=a+secret", is_socket=True, peer=peer)
        assert [status(each) for each in (by_header, by_cookie, by_query)] == [None] * 3


def test_the_token_of_an_address_becomes_a_cookie_that_does_not_contain_it():
    redirect = redirect_to_cookie(request("/servos", query="a=1&token=a%20secret&b=2"), TOKEN)

    assert isinstance(redirect, Redirect)
    assert redirect.location == "/servos?a=1&b=2"
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(redirect.cookie.split("; "))
    assert TOKEN not in redirect.cookie
    assert status(request("/servos", cookie=redirect.cookie.split(";")[0])) is None


@pytest.mark.parametrize("path", ["//evil.example/", "/\\evil.example", "/\\/evil.example"])
def test_no_redirect_leads_to_another_host(path):
    location = redirect_to_cookie(request(path, query="token=a+secret"), TOKEN).location
    assert location in ("/evil.example/", "/evil.example")


@given(
    st.sampled_from([None, TOKEN]),
    st.text(max_size=40),
    st.dictionaries(
        st.sampled_from(["host", "origin", "cookie", "authorization", "sec-fetch-site"]),
        st.text(max_size=40),
    ),
    st.booleans(),
)
def test_whatever_comes_only_the_token_opens(token, query, headers, is_socket):
    given = Request("GET", "/api/status", query, {"host": HOST, **headers}, is_socket, HERE)
    try:
        refused = refusal(given, Policy(token))
    except ValueError:  # answered by 400
        return
    assert refused is None or isinstance(refused, Refusal)
    if token is not None:
        assert isinstance(refused, Refusal)
