import pytest
from places import short_folder


@pytest.fixture
def own_folder(monkeypatch):
    """Faces of this test only; where their sockets lie."""
    folder = short_folder()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    runtime = "firmware_bridge.process.runtime_folder"
    monkeypatch.setattr(f"{runtime}.SERVICE_FOLDER", folder / "none")
    monkeypatch.setattr(f"{runtime}._folders_of_others", lambda: iter(()))
    return folder
