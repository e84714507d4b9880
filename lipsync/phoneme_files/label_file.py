"""The label file that a user names, and what the user says of it."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class LabelFile:
    """A file of labels. tier: the one to read, or `words`; alphabet: of its phonemes or visemes.

    Where they are "", the file decides, and is refused if it leaves them in doubt.
    """

    path: Path
    tier: str = ""
    alphabet: str = ""
