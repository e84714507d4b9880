"""What a face answers its clients."""

from dataclasses import dataclass
from typing import Any

#: A message of the face, as docs/agents.md lists them.
Event = dict[str, Any]


class FaceError(Exception):
    """The face refused, or is not there. code: of docs/agents.md, to be told apart by programs."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class Played:
    """What became of speech. finished: it was heard whole; else it was cut off.

    played_s: was heard; dropped_s: never will be.
    """

    finished: bool
    played_s: float
    dropped_s: float = 0.0


def played_of(event: Event) -> Played:
    """What the last event of a stream says of it."""
    finished = event["type"] == "finished"
    return Played(finished, float(event["played_s"]), float(event.get("dropped_s", 0.0)))


def error_of(event: Event) -> FaceError:
    """An `error` event, to be raised."""
    return FaceError(str(event.get("code", "")), str(event.get("message", "")))
