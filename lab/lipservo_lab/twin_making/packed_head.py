"""Packs the head of the shipped face model for pages, when model or head have changed.

`python -m lipservo_lab.twin_making.packed_head`.
"""

import gzip
from importlib import resources
from pathlib import Path

from lipsync.face.model import load_face
from lipsync.twin.packed import pack
from lipsync.twin.twin import make_twin


def main() -> None:
    """Replace the head that is kept beside the shipped model."""
    folder = Path(str(resources.files("lipsync.models")))
    for old in folder.glob("head-*.bin.gz"):
        old.unlink()
    face = load_face()
    head = gzip.compress(pack(make_twin(face)), mtime=0)
    (folder / f"head-{face.checksum}.bin.gz").write_bytes(head)


if __name__ == "__main__":
    main()
