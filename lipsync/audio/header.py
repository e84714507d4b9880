"""Sound files opened and judged by their headers: nothing here decodes sound.

The time that this takes does not depend on how long the file is.
"""

import os
import re
import stat
from pathlib import Path

import soundfile

from lipsync.audio.source import SoundError

#: A telephone has 8 kHz, a studio 192; below 4 kHz there is no speech left to recognise.
SLOWEST_RATE_HZ, FASTEST_RATE_HZ = 4_000, 192_000
#: More than any recorder writes; a header that says more is damaged.
MOST_CHANNELS = 32
LONGEST_S = 1_000 * 3600.0
#: One analysis window of a recogniser; nothing can be recognised in less.
SHORTEST_S = 0.025
#: What programs write as a size before they know it (ffmpeg, arecord, sox into a pipe).
_UNKNOWN_BYTES = 0x7FFF_F000
#: How libsndfile's log of a header says that less is there than was promised, in bytes.
_CUT_SHORT = re.compile(r"^\s*(?:data|SSND) : (\d+) \(should be (\d+)\)", re.MULTILINE)


def open_sound(path: Path) -> soundfile.SoundFile:
    """The file, ready to decode. Raises SoundError for what is missing or no sound file.

    A pipe or a device is refused without being opened: to open one can take for ever. So are
    sample rates outside 4 to 192 kHz and more than 32 channels.
    """
    _refuse_other_than_files(path)
    try:
        sound = soundfile.SoundFile(os.fsencode(path))  # names need not be UTF-8
    except soundfile.LibsndfileError as error:
        raise SoundError(
            f"{path}: not a sound file that can be read ({reason_of(error)}); "
            "use WAV, FLAC, OGG or Opus"
        ) from error
    try:
        _refuse_odd_settings(path, sound)
    except SoundError:
        sound.close()
        raise
    return sound


def promised_s(sound: soundfile.SoundFile) -> float | None:
    """How long the header says that the sound is, where the file ends before; None where not.

    Known of WAV and AIFF; of other kinds only decoding tells.
    """
    found = _CUT_SHORT.search(sound.extra_info)
    if found is None:
        return None
    promised, there = int(found[1]), int(found[2])
    if promised >= _UNKNOWN_BYTES or not 0 < there < promised:
        return None
    return float(sound.frames / sound.samplerate * promised / there)


def reason_of(error: soundfile.LibsndfileError) -> str:
    """What libsndfile says, or its error's number where it has no words for it."""
    return str(error.error_string).strip().rstrip(".:") or f"libsndfile error {error.code}"


def _refuse_other_than_files(path: Path) -> None:
    try:
        kind = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        raise SoundError(f"{path}: no such file; check the path") from error
    except OSError as error:
        raise SoundError(f"{path}: cannot be read ({error.strerror}); check its rights") from error
    except ValueError as error:  # a name with a zero byte
        raise SoundError(f"{str(path)!r}: no file can have this name; check the path") from error
    if stat.S_ISDIR(kind):
        raise SoundError(f"{path}: is a directory; give the path of a sound file")
    if not stat.S_ISREG(kind):
        raise SoundError(
            f"{path}: is a pipe or a device, not a file; save the sound to a file first, "
            "or listen with --mic"
        )
    try:
        with path.open("rb") as file:
            is_empty = not file.read(1)
    except OSError as error:
        raise SoundError(f"{path}: cannot be read ({error.strerror}); check its rights") from error
    if is_empty:
        raise SoundError(f"{path}: the file is empty (0 bytes); record or copy it again")


def _refuse_odd_settings(path: Path, sound: soundfile.SoundFile) -> None:
    if not SLOWEST_RATE_HZ <= sound.samplerate <= FASTEST_RATE_HZ:
        raise SoundError(
            f"{path}: a sample rate of {sound.samplerate} Hz is not possible here "
            f"({SLOWEST_RATE_HZ} to {FASTEST_RATE_HZ} Hz are); export the file again"
        )
    if sound.channels > MOST_CHANNELS:
        raise SoundError(
            f"{path}: {sound.channels} channels are not possible here (up to {MOST_CHANNELS} "
            "are); export the file again"
        )
