"""Archives of arrays, `.npz` without pickle, read within bounds of memory.

Packed data may be a thousand times larger unpacked, and a header may promise arrays that no memory
holds. So each size is compared with a bound before memory is used: that of the list of members
before the list is parsed, that of each member before it is unpacked, and the shape of an array with
the number of its bytes. Only plain arrays are read: numbers, booleans and texts as `numpy.savez`
and `savez_compressed` write them.
"""

import io
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import IO, Any, Final, Self

import numpy as np
from numpy.typing import NDArray

#: What reading an archive that is damaged may raise, by where the damage is.
UNREADABLE: Final = (
    OSError,
    ValueError,
    EOFError,
    RuntimeError,
    MemoryError,
    zlib.error,
    zipfile.BadZipFile,
)
_MOST_MEMBERS: Final = 1_000
#: Of the list of members at the end of an archive.
_MOST_LISTED_BYTES: Final = 128 * _MOST_MEMBERS
#: A zip archive's last record: "PK\5\6", the size of the list of members, and the length of a
#: comment, which NumPy never writes.
_END: Final = struct.Struct("<4s8xL4xH")
_END_64_BYTES: Final = 20
#: Before a member: the lengths of its name and of what follows the name (APPNOTE.TXT, 4.3.7).
_LOCAL_HEAD: Final = struct.Struct("<26xHH")
_CHUNK_BYTES: Final = 1 << 20
#: Magic and length before the header of an array; of version 1 with 2 bytes of length.
_HEAD_BYTES: Final = 10
_HEADER: Final = re.compile(
    r"\{'descr': '([<>|=][biufU]\d{1,6})', 'fortran_order': (True|False), "
    r"'shape': \(((?:\d{1,12}, ?){0,8}(?:\d{1,12})?)\), \} *\n"
)


def about_in(head: bytes) -> bytes:
    """Return the content of the array `about` as far as it lies in an archive's first bytes `head`.

    Empty if the archive does not begin with `about`, or is none; the array's own header is
    included.
    """
    if not head.startswith(b"PK\3\4") or len(head) < _LOCAL_HEAD.size:
        return b""
    n_name, n_extra = _LOCAL_HEAD.unpack_from(head)
    name_end = _LOCAL_HEAD.size + n_name
    if head[_LOCAL_HEAD.size : name_end] != b"about.npy":
        return b""
    try:
        return zlib.decompressobj(-zlib.MAX_WBITS).decompress(head[name_end + n_extra :])
    except zlib.error:
        return b""


class ArrayArchive:
    """The arrays of an .npz file, by name. Use it as a context manager.

    Opening it or reading an array of a damaged file raises one of the errors `UNREADABLE`; the text
    of a ValueError is the fault in a few words.
    """

    def __init__(
        self, file: IO[bytes], most_bytes: int, most_of: Mapping[str, int] | None = None
    ) -> None:
        """Open an archive; raise one of `UNREADABLE` if it is damaged or exceeds a limit.

        file: open; the caller closes it. most_bytes: limit of all arrays together, unpacked.
        most_of: lower limits of single arrays, in bytes unpacked, by name.
        """
        _check_member_list(file)
        self._zip = zipfile.ZipFile(file)
        self._members = {
            member.filename.removesuffix(".npy"): member for member in self._zip.infolist()
        }
        if len(self._members) > _MOST_MEMBERS:
            raise ValueError(f"the file has more than {_MOST_MEMBERS} arrays")
        # Not only of those that will be read: what nobody reads has no place in an archive either.
        n_bytes = sum(member.file_size for member in self._zip.infolist())
        if n_bytes > most_bytes:
            raise ValueError(f"{_mb(n_bytes)} unpacked; at most {_mb(most_bytes)} are read")
        for name, most in (most_of or {}).items():
            member = self._members.get(name)
            if member is not None and member.file_size > most:
                size = _mb(member.file_size)
                raise ValueError(f"array {name!r} is {size} unpacked; at most {_mb(most)} are read")

    @property
    def names(self) -> list[str]:
        """The names of all arrays, in the order in which they are stored."""
        return list(self._members)

    def __contains__(self, name: str) -> bool:
        return name in self._members

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Read and return the array `name`; raise KeyError if there is none.

        Raises one of `UNREADABLE` if the array is damaged.
        """
        with self._opened(name) as (file, shape, dtype, order):
            # Read in pieces into one buffer, so that never twice the array is in memory.
            data = bytearray(math.prod(shape) * dtype.itemsize)
            view = memoryview(data)
            n_read = 0
            while chunk := file.read(_CHUNK_BYTES):
                view[n_read : n_read + len(chunk)] = chunk
                n_read += len(chunk)
            if n_read != len(data):
                raise ValueError(f"array {name!r} is cut short")
        return (
            np.ndarray(shape, dtype, buffer=data, order=order) if data else np.empty(shape, dtype)
        )

    def chunks(self, name: str) -> Iterator[bytes]:
        """Yield the bytes of the array `name`, (n,) uint8, in pieces of at most 1 MiB.

        Raises ValueError for an array of another type or shape.
        """
        with self._opened(name) as (file, shape, dtype, _):
            if dtype != np.uint8 or len(shape) != 1:
                raise ValueError(f"entry {name!r} is not stored as bytes")
            while chunk := file.read(_CHUNK_BYTES):
                yield chunk

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._zip.close()

    @contextmanager
    def _opened(self, name: str) -> Iterator[tuple[IO[bytes], tuple[int, ...], np.dtype[Any], Any]]:
        """Yield the array `name` as (file at its first value, shape, type, order "C" or "F")."""
        member = self._members[name]
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"array {name!r} is compressed in a way that NumPy does not write")
        with self._zip.open(member) as file:
            head = file.read(_HEAD_BYTES)
            # NumPy's magic string, version 1.0, and the length of the header that follows.
            if head[:8] != b"\x93NUMPY\x01\x00" or len(head) != _HEAD_BYTES:
                raise ValueError(f"array {name!r} has no plain numbers")
            n_header = int.from_bytes(head[8:], "little")
            header_match = _HEADER.fullmatch(file.read(n_header).decode("latin-1"))
            if header_match is None:
                raise ValueError(f"array {name!r} has no plain numbers")
            dtype = np.dtype(header_match[1])
            shape = tuple(int(each) for each in header_match[3].replace(",", " ").split())
            n_bytes = member.file_size - _HEAD_BYTES - n_header
            if dtype.itemsize == 0 or math.prod(shape) * dtype.itemsize != n_bytes:
                raise ValueError(f"array {name!r}: {n_bytes} bytes for {shape} values")
            yield file, shape, dtype, "F" if header_match[2] == "True" else "C"


def arrays_of(file: IO[bytes], most_bytes: int) -> dict[str, NDArray[Any]]:
    """Return all arrays of an archive. Raises one of `UNREADABLE` for a damaged or too large one.

    Parameters
    ----------
    file : IO[bytes]
        An open .npz file.
    most_bytes : int
        Limit of all arrays together, in bytes unpacked.

    Returns
    -------
    dict[str, NDArray[Any]]
        By name, each of the shape that the file gives it.
    """
    with ArrayArchive(file, most_bytes) as archive:
        return {name: archive[name] for name in archive.names}


def _check_member_list(file: IO[bytes]) -> None:
    """Raise ValueError unless the file ends with a zip member list of bounded size; then rewind."""
    end = file.seek(0, io.SEEK_END)
    file.seek(max(0, end - _END.size - _END_64_BYTES))
    tail = file.read()
    if len(tail) < _END.size or tail[-_END.size :][:4] != b"PK\x05\x06":
        raise ValueError("the file is not an archive of arrays")
    _, n_list_bytes, n_comment = _END.unpack(tail[-_END.size :])
    if n_comment or tail.startswith(b"PK\x06\x07") or n_list_bytes > _MOST_LISTED_BYTES:
        raise ValueError("the file's list of arrays is too long")
    file.seek(0)


def _mb(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:,.1f} MB"
