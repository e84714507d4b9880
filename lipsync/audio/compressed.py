"""MP3 and Ogg files: whether one is cut off, and what their decoder prints."""

import os
import re
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import soundfile

#: Bytes of an MP3 file within which its first frame lies.
_LONGEST_HEADER: Final = 4096
#: RFC 3533, section 6: the longest page of an Ogg file, and the bit of a stream's last one.
_LONGEST_PAGE, _LAST_PAGE = 65_307, 0x04
_STDERR: Final = 2
#: As libsndfile calls it.
MP3: Final = ("MP3", "MPEG")
#: stderr is one for all threads.
_ONE_AT_A_TIME: Final = threading.Lock()
#: How lines of libmpg123 begin.
_OF_MPG123: Final = re.compile(
    rb"(?:Note|Warning|Error|\[?src/libmpg123|\[[^\]\n]*mpg123|[a-z_0-9]+\.c:\d+)[^\n]*\n|\s*\n"
)


def begins_as_mp3(path: Path) -> bool:
    """Return whether a file begins as MP3 files do: with a tag, or with a frame."""
    with path.open("rb") as file:
        head = file.read(3)
    return head == b"ID3" or (head[:1] == b"\xff" and head[1:2] >= b"\xe0")


@contextmanager
def quiet_decoder(*, is_mp3: bool) -> Iterator[None]:
    """Keep what libmpg123 prints about an MP3 file out of stderr, and nothing else.

    libmpg123 writes to the file descriptor, whatever libsndfile is set to. What other threads write
    to stderr meanwhile is written afterwards.
    """
    if not is_mp3:
        yield
        return
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as written:
        try:
            stderr = os.dup(_STDERR)
        except OSError:  # there is none
            yield
            return
        try:
            os.dup2(written.fileno(), _STDERR)
            yield
        finally:
            os.dup2(stderr, _STDERR)
            os.close(stderr)
            written.seek(0)
            if others := _OF_MPG123.sub(b"", written.read()):
                os.write(_STDERR, others)


def present_share(path: Path, sound: soundfile.SoundFile) -> float:
    """Return the share of an MP3 file's bytes that is there, of those promised by its first frame.

    1.0 for a file whose first frame promises nothing (Xing,
    https://www.codeproject.com/Articles/8295), and for all other formats.
    """
    if sound.format not in MP3:
        return 1.0
    with path.open("rb") as file:
        head = file.read(_LONGEST_HEADER)
        if head[:3] == b"ID3":  # ID3v2, section 3.1: seven bits a byte
            id3_size = 10 + sum((byte & 0x7F) << 7 * (3 - n) for n, byte in enumerate(head[6:10]))
            file.seek(id3_size)
            head = file.read(_LONGEST_HEADER)
        else:
            id3_size = 0
    # The Xing header in the first frame: 4 bytes name, flags, number of frames, number of bytes.
    at = max(head.find(b"Xing"), head.find(b"Info"))
    if at < 0 or len(head) < at + 16 or head[at + 7] & 3 != 3:  # neither frames nor bytes are given
        return 1.0
    promised = int.from_bytes(head[at + 12 : at + 16], "big")
    return min(1.0, (path.stat().st_size - id3_size) / promised) if promised else 1.0


def lacks_its_end(path: Path, sound: soundfile.SoundFile) -> bool:
    """Return whether an Ogg file does not end with the page that says so (RFC 3533, section 6)."""
    if sound.format != "OGG":
        return False
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _LONGEST_PAGE))
        tail = file.read()
    page_start = tail.rfind(b"OggS")
    return page_start < 0 or len(tail) < page_start + 6 or not tail[page_start + 5] & _LAST_PAGE
