"""What tests of sound devices share."""

import pytest
from fake_sound_card import install_sound_card


@pytest.fixture
def card(monkeypatch):
    """A sound card with a loudspeaker and a microphone, and two other devices."""
    return install_sound_card(monkeypatch)
