"""Where the dashboard listens."""

import pytest

from lipservo.dashboard.child import FIRST_PORT, bound_dashboard
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
