"""Which sound a command was asked to hear."""

from importlib import resources
from pathlib import Path

import typer

from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter
from lipsync.audio.source import AudioSource


def open_source(wav: Path | None, mic: str | None) -> AudioSource:
    """The file, the microphone, or the bundled clip."""
    if wav is not None and mic is not None:
        raise typer.BadParameter("give --wav or --mic, not both")
    if mic is not None:
        from lipsync.audio.microphone import MicrophoneSource

        named = None if mic == "default" else int(mic) if mic.isdigit() else mic
        return MicrophoneSource(named)
    if wav is not None:
        return SilenceAfter(FileSource(wav))
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        return SilenceAfter(FileSource(clip))
