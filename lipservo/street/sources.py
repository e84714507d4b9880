"""Which sound a command means: a file, a microphone, the bundled clip, nothing at all."""

from importlib import resources
from pathlib import Path

from lipservo.terminal.output import MESSAGES
from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter, SilentSource
from lipsync.audio.source import AudioSource

#: The microphone that the system prefers.
DEFAULT_MICROPHONE = "default"


def open_source(wav: Path | None, mic: str | None, start_s: float = 0.0) -> AudioSource:
    """The file, the microphone, or the bundled clip; `wav` and `mic` are not both given.

    start_s: the sound time at which a file is taken up; its blocks keep the file's times. A file
    is checked here, in a time that does not depend on its length; raises SoundError.
    """
    if mic is not None:
        return open_microphone(mic)
    if wav is not None:
        return _file(wav, start_s)
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        return _file(clip, start_s)


def open_source_or_silence(wav: Path | None, mic: str | None, start_s: float = 0.0) -> AudioSource:
    """As `open_source`, but silence without end rather than the clip."""
    if wav is None and mic is None:
        return SilentSource(start_s)
    return open_source(wav, mic, start_s)


def open_microphone(device: str) -> AudioSource:
    """A microphone by number, by part of its name, or the default one. Raises SoundError."""
    from lipsync.audio.microphone import MicrophoneSource

    named = None if device == DEFAULT_MICROPHONE else int(device) if device.isdigit() else device
    return MicrophoneSource(named)


def warn(line: str) -> None:
    """One line on stderr about a sound that is used all the same."""
    MESSAGES.print(line, soft_wrap=True, markup=False, highlight=False)


def _file(path: Path, start_s: float) -> AudioSource:
    return SilenceAfter(FileSource(path, start_s=start_s, warn=warn), start_s)
