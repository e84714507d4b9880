"""What the user settles about voice agents, and the bounds that hold for every one of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from lipservo.access.admission import Policy

#: Says a text, or plays a file; gives what is told of it, such as its length. Called in a thread of
#: its own. A ValueError is told to the client as it stands.
Speak = Callable[[str], Mapping[str, object] | None]


@dataclass(frozen=True, slots=True)
class AgentSettings:
    """The bounds of an `AgentServer`.

    policy: who may connect.
    when_busy: what becomes of a stream while somebody else's is said. most_streams: that are said
    or wait, of all clients together. messages_per_s: of one client; more wait in its own socket.
    first_message_s: a client that has said nothing by then is disconnected. stalled_s: a stream
    that gets no audio for so long is ended. position_s: between two
    positions that are told unasked. ping_s: a client is asked so often whether it is there, and has
    as long to answer.
    """

    policy: Policy = field(default_factory=Policy)
    when_busy: Literal["refuse", "queue"] = "refuse"
    most_connections: int = 8
    most_streams: int = 8
    most_message_bytes: int = 1 << 20
    messages_per_s: float = 2000.0
    first_message_s: float = 10.0
    stalled_s: float = 60.0
    position_s: float = 0.25
    ping_s: float = 20.0
