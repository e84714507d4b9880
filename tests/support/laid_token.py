"""What may lie where a face keeps its token."""

import os


def laid(folder, how):
    """Something in the token's place."""
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
