"""What tests of the agents' server share."""

import pytest
from voice_agents.served_face import ServedFace


@pytest.fixture
def face():
    """A face that agents connect to."""
    with ServedFace() as served:
        yield served
