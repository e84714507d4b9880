"""Which sound a command means: a file, a microphone, the bundled clip, nothing at all."""

from importlib import resources
from pathlib import Path

from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter, SilentSource
from lipsync.audio.source import AudioSource

#: The microphone that the system prefers.
DEFAULT_MICROPHONE = "default"


def open_source(wav: Path | None, mic: str | None) -> AudioSource:
    """The file, the microphone, or the bundled clip; `wav` and `mic` are not both given."""
    if mic is not None:
        return open_microphone(mic)
    if wav is not None:
        return SilenceAfter(FileSource(wav))
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        return SilenceAfter(FileSource(clip))


def open_source_or_silence(wav: Path | None, mic: str | None) -> AudioSource:
    """As `open_source`, but silence without end rather than the clip."""
    return SilentSource() if wav is None and mic is None else open_source(wav, mic)


def open_microphone(device: str) -> AudioSource:
    """A microphone by number, by part of its name, or the default one. Raises SoundError."""
    from lipsync.audio.microphone import MicrophoneSource

    named = None if device == DEFAULT_MICROPHONE else int(device) if device.isdigit() else device
    return MicrophoneSource(named)
