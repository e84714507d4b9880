"""Where things lie in the checkout, and folders to write into."""

import atexit
import shutil
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"


def short_folder() -> Path:
    """A new folder for its owner alone, gone when the tests are over.

    Its name leaves room for a socket's: the address of a socket holds 107 bytes in all.
    """
    folder = Path(tempfile.mkdtemp(prefix="lipservo-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
