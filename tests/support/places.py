"""Where things lie in the checkout, and folders to write into."""

import atexit
import os
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


def laid(folder, how):
    """Something in the place of the token that `folder` should hold."""
    folder.mkdir()
    path = folder / "token"
    if how == "link":
        (folder / "mine").write_text("a secret\n")
        path.symlink_to(folder / "mine")
    elif how == "broken link":
        path.symlink_to(folder / "nothing")
    elif how == "folder":
        path.mkdir()
    elif how == "fifo":
        os.mkfifo(path, 0o600)
    else:
        path.write_text("" if how == "empty" else "a secret\n")
        path.chmod({"others read": 0o644, "group writes": 0o660}.get(how, 0o640))
    return path
