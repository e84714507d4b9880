from pathlib import Path

import pytest
from hypothesis import settings

# Machines are shared: how long an example takes says nothing about the code.
settings.register_profile("lipservo", deadline=None)
settings.load_profile("lipservo")


@pytest.fixture(scope="session")
def corpus_dir() -> Path:
    """The corpora, which lie beside the checkout and are not part of it."""
    folder = Path(__file__).parents[2] / "shared" / "corpus"
    if not folder.is_dir():
        pytest.skip(f"the corpora are not at {folder}")
    return folder
