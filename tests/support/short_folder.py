"""A folder whose name leaves room for a socket's: a socket's address holds 107 bytes in all."""

import atexit
import shutil
import tempfile
from pathlib import Path


def short_folder() -> Path:
    """A new one for its owner alone; it is gone when the tests are over."""
    folder = Path(tempfile.mkdtemp(prefix="lipservo-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
