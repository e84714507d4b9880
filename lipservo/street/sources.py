"""Which sound a command means: a file, a microphone, the bundled clip, nothing at all."""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

from lipservo.terminal.output import MESSAGES
from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter, SilentSource
from lipsync.audio.source import AudioSource

#: The microphone that the system prefers.
DEFAULT_MICROPHONE = "default"


@dataclass(frozen=True, slots=True)
class Sound:
    """Which sound a face is to hear, or to say.

    name: a file's path, a microphone by number or name, or the text. language: of the text.
    phonemes: a file of what is said when; without one it is recognised.
    """

    kind: Literal["clip", "file", "microphone", "silence", "text"]
    name: str = ""
    language: str = ""
    phonemes: str = ""


#: The bundled clip.
CLIP = Sound("clip")
#: Nothing, without end.
SILENCE = Sound("silence")


def chosen_sound(wav: Path | None, mic: str | None, otherwise: Sound) -> Sound:
    """The file or the microphone, of which at most one is given; with neither, `otherwise`."""
    if mic is not None:
        return Sound("microphone", mic)
    return otherwise if wav is None else Sound("file", str(wav))


def open_sound(sound: Sound, start_s: float = 0.0) -> AudioSource:
    """The sound, to be entered. Raises SoundError.

    start_s: the sound time at which a file is taken up; its blocks keep the file's times. A file
    is checked here, in a time that does not depend on its length.
    """
    if sound.kind == "microphone":
        return open_microphone(sound.name)
    if sound.kind == "silence":
        return SilentSource(start_s)
    if sound.kind == "file":
        return _file(Path(sound.name), start_s)
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        return _file(clip, start_s)


def open_microphone(device: str) -> AudioSource:
    """A microphone by number, by part of its name, or the default one. Raises SoundError."""
    from lipsync.audio.microphone import MicrophoneSource

    return MicrophoneSource(None if device == DEFAULT_MICROPHONE else device)


def warn(line: str) -> None:
    """One line on stderr about a sound that is used all the same."""
    MESSAGES.print(line, soft_wrap=True, markup=False, highlight=False)


def _file(path: Path, start_s: float) -> AudioSource:
    return SilenceAfter(FileSource(path, start_s=start_s, warn=warn), start_s)
