"""What the user asked for of a robot that speaks."""

from dataclasses import dataclass

#: Where a daemon waits for voice agents.
DEFAULT_LISTEN = "127.0.0.1:8765"
#: The loudspeaker that the system prefers.
DEFAULT_OUTPUT = "default"


@dataclass(frozen=True, slots=True)
class VoiceOptions:
    """A robot that speaks by itself.

    output: its loudspeaker, by number, name or part of a name; None: nobody plays, or whoever sends
    the sound does. token_file: whose first line clients must send; None: those of this computer
    need none. sounds: the folder below which they may let sound files be played. queue: whether
    they wait for their turn while another speaks, or are refused. origins: of web pages that may
    connect, as the face's YAML lists them, with commas between.
    """

    output: str | None = None
    token_file: str | None = None
    sounds: str | None = None
    queue: bool = False
    origins: str = ""
