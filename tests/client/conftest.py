"""What tests of clients share."""

import socket

import pytest


@pytest.fixture
def unused_ports():
    """Two ports of this computer at which nobody listens."""
    with socket.socket() as one, socket.socket() as other:
        for probe in (one, other):
            probe.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


@pytest.fixture
def unused_port(unused_ports):
    """One of them."""
    return unused_ports[0]
