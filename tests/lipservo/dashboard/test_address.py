"""Where the dashboard listens."""

import sys

import pytest

from firmware_bridge.process.logs import LOG_JSON
from lipservo.dashboard.child import FIRST_PORT, address_line, bound_dashboard
from lipsync.errors import UserError


def test_two_dashboards_have_two_ports_of_this_computer():
    with bound_dashboard(None, None) as first, bound_dashboard(None, None) as second:
        (host, one), (_, two) = first.getsockname(), second.getsockname()
        assert host == "127.0.0.1"
        assert one != two
        assert min(one, two) >= FIRST_PORT


def test_beyond_this_computer_only_with_a_token():
    with pytest.raises(UserError, match="token"):
        bound_dashboard("0.0.0.0:0", None)
    with bound_dashboard("0.0.0.0:0", "secret") as listener:
        assert listener.getsockname()[0] == "0.0.0.0"


@pytest.mark.parametrize(
    ("is_terminal", "logs_json", "shows_token"),
    [(True, "", True), (True, "1", False), (False, "", False)],
)
def test_the_token_is_shown_in_a_terminal_and_stands_in_no_log(
    is_terminal, logs_json, shows_token, monkeypatch
):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    monkeypatch.setenv(LOG_JSON, logs_json)
    with bound_dashboard(None, "secret") as listener:
        for page in ("", "first-hour"):
            line = address_line(listener, "secret", page)
            assert line.startswith(f"dashboard: http://127.0.0.1:{listener.getsockname()[1]}")
            assert ("token=secret" in line) == ("secret" in line) == shows_token
