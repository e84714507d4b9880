"""What tests of clients share."""

import socket

import pytest


@pytest.fixture
def unused_port():
    """A port of this computer at which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
