"""What reading an .npz that is damaged may raise, by where the damage is."""

import zipfile
import zlib
from typing import Final

UNREADABLE: Final = (
    OSError,
    ValueError,
    EOFError,
    RuntimeError,
    MemoryError,
    zlib.error,
    zipfile.BadZipFile,
)
