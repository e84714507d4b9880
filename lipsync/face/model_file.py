"""Model files: one `.npz` without pickle, in parts, of which each reader loads only its own.

A member of the archive is called `PART/ARRAY`. `about` comes first and says in JSON what the file
is. Nothing is read of a part before it is asked for.
"""

import io
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lipsync.array_archive import UNREADABLE, ArrayArchive
from lipsync.errors import UserError
from lipsync.face.former_files import FORMER_VERSION, former_layout, former_members
from lipsync.markers import PointLayout, layout_of
from lipsync.output_file import write_whole
from lipsync.phonemes import PHONEMES

Arrays = Mapping[str, NDArray[np.generic]]
Part = TypeVar("Part")

#: Raised whenever the meaning of a stored field changes; files of other versions are refused, but
#: for the one before, which holds the same under other names.
MODEL_VERSION = 4
SHIPPED_MODEL = "grid_s1"
#: Thirty times the shipped one, unpacked.
_MOST_BYTES = 64_000_000
_ABOUT = "about"
_TRAIN_AGAIN = "train it again with `lipservo learn face`"


class ModelError(UserError):
    """A model file that cannot be used: says which, why, and what to do."""


class ModelFile:
    """An open model file.

    name: for messages. about: what it says of itself. layout: the points of its face.
    """

    def __init__(self, name: str, archive: ArrayArchive) -> None:
        self.name = name
        self._archive = archive
        try:
            self.about: dict[str, Any] = json.loads(archive[_ABOUT].tobytes())
            version = self.about["version"]
        except (KeyError, TypeError, *UNREADABLE) as error:
            raise self._damaged() from error
        if version not in (FORMER_VERSION, MODEL_VERSION):
            raise ModelError(
                f"{name}: model version {version}, this lipservo reads version {MODEL_VERSION}; "
                + _TRAIN_AGAIN
            )
        self._is_former = version == FORMER_VERSION
        try:
            if self.about["phonemes"] != list(PHONEMES):
                raise ValueError("its phoneme inventory differs")
            self.layout: PointLayout = (
                former_layout(self.about["marker_names"])
                if self._is_former
                else layout_of(self.about["layout"])
            )
        except (KeyError, TypeError, ValueError, AttributeError, UserError) as error:
            raise self._damaged(error) from error

    def read(self, part: str, assemble: Callable[[Arrays], Part]) -> Part:
        """What `assemble` makes of the arrays of a part, which it gets by name.

        Raises ModelError for a part that is not there or is damaged, and for what `assemble`
        raises: KeyError, ValueError, TypeError or IndexError.
        """
        members = {
            name.removeprefix(f"{part}/"): stored
            for name, stored in self._members().items()
            if name.startswith(f"{part}/")
        }
        if not members:
            raise ModelError(f"{self.name}: holds no part {part!r}; {_TRAIN_AGAIN}")
        try:
            return assemble({name: self._archive[stored] for name, stored in members.items()})
        except ModelError:
            raise
        except (KeyError, TypeError, IndexError, *UNREADABLE) as error:
            raise self._damaged(error) from error

    def _members(self) -> dict[str, str]:
        """What an array is called today, and under which name this file keeps it."""
        stored = self._archive.names
        return former_members(stored) if self._is_former else {name: name for name in stored}

    def _damaged(self, error: Exception | None = None) -> ModelError:
        why = f" ({error})" if error is not None else ""
        return ModelError(
            f"{self.name}: damaged or not a lipservo model; get a fresh copy or train one again"
            + why
        )


@contextmanager
def open_model(path: Path | None = None) -> Iterator[ModelFile]:
    """The model file at a path; None: the one that comes with the package.

    Raises ModelError for a file that is missing, damaged, foreign or of another version.
    """
    name = f"shipped model {SHIPPED_MODEL}" if path is None else str(path)
    place = resources.files("lipsync.models") / f"{SHIPPED_MODEL}.npz" if path is None else path
    with ExitStack() as stack:
        try:
            stream = stack.enter_context(place.open("rb"))
        except FileNotFoundError:
            remedy = (
                "reinstall lipservo" if path is None else "train one with `lipservo learn face`"
            )
            raise ModelError(f"{name}: no such model file; {remedy}") from None
        except OSError as error:
            raise ModelError(f"{name}: cannot be read: {error.strerror}") from error
        try:
            archive = stack.enter_context(ArrayArchive(stream, _MOST_BYTES))
        except UNREADABLE as error:
            raise ModelError(
                f"{name}: damaged or not a lipservo model ({error}); get a fresh copy or train one "
                "again"
            ) from error
        yield ModelFile(name, archive)


def write_model(
    path: Path, layout: PointLayout, about: Mapping[str, object], parts: Mapping[str, Arrays]
) -> None:
    """Write a model file whole or not at all. Raises OutputError."""
    said = {
        "version": MODEL_VERSION,
        "layout": layout.description(),
        "phonemes": PHONEMES,
        **about,
    }
    arrays: dict[str, NDArray[np.generic]] = {
        _ABOUT: np.frombuffer(json.dumps(said).encode(), dtype=np.uint8)
    }
    for part, members in parts.items():
        arrays |= {f"{part}/{name}": values for name, values in members.items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_whole(path, buffer.getvalue())


def is_model(head: bytes) -> bool:
    """Whether a file that begins so looks like a model: a zip archive that begins with `about`."""
    return head.startswith(b"PK") and b"about.npy" in head
