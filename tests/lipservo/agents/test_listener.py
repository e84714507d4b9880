"""Where a face listens, and what is said where it may not."""

import os
import re

import pytest

from lipservo.agents.listener import bind_listener, url_of
from lipsync.errors import UserError


@pytest.mark.parametrize("spec", ["127.0.0.1:0", "localhost:0", "[::1]:0"])
def test_loopback_needs_no_token(spec):
    with bind_listener(spec, None) as listener:
        assert re.fullmatch(r"ws://(127\.0\.0\.1|\[::1\]):[1-9]\d*", url_of(listener))


@pytest.mark.parametrize("spec", ["0.0.0.0:8765", "192.0.2.7:8765", "[::]:8765", "robot:8765"])
@pytest.mark.parametrize("token", [None, ""])
def test_elsewhere_a_token_is_needed(spec, token):
    with pytest.raises(UserError, match=r"needs a token.*127\.0\.0\.1:8765"):
        bind_listener(spec, token)


def test_with_a_token_others_may_reach_it():
    with bind_listener("0.0.0.0:0", "secret") as listener:
        assert listener.getsockname()[0] == "0.0.0.0"


def test_who_holds_a_port_is_named():
    with bind_listener("127.0.0.1:0", None) as first:
        spec = "{}:{}".format(*first.getsockname())
        with pytest.raises(UserError, match=rf"{spec}: is taken by process {os.getpid()} \("):
            bind_listener(spec, None)


@pytest.mark.parametrize(
    "spec", ["", "8765", "127.0.0.1", ":8765", "127.0.0.1:port", "::1:8765", "127.0.0.1:65536"]
)
def test_what_is_no_address_is_told_with_an_example(spec):
    with pytest.raises(UserError, match=r"HOST:PORT, such as 127\.0\.0\.1:8765"):
        bind_listener(spec, None)


def test_a_host_that_does_not_exist_is_told():
    with pytest.raises(UserError, match="cannot listen there"):
        bind_listener("no.such.host.invalid:8765", "secret")
