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
    the sound does. listen: HOST:PORT where voice agents are waited for; None: nowhere.
    token_file: whose first line they must know; None: loopback alone needs none.
    """

    output: str | None = None
    listen: str | None = None
    token_file: str | None = None
