"""`python -m lipservo_lab.twin_making.packed_head`: pack the shipped head for web pages.

To be run when the model or the head has changed.
"""

import gzip
from importlib import resources
from pathlib import Path

from lipsync.face.model import load_face
from lipsync.twin.packed import pack
from lipsync.twin.twin import make_twin


def main() -> None:
    """Replace the packed head that is stored beside the shipped model."""
    folder = Path(str(resources.files("lipsync.models")))
    for old in folder.glob("head-*.bin.gz"):
        old.unlink()
    face = load_face()
    head = gzip.compress(pack(make_twin(face)), mtime=0)
    (folder / f"head-{face.checksum}.bin.gz").write_bytes(head)


if __name__ == "__main__":
    main()
