"""What a face's parent process does about its bridge: the table of `Supervisor`."""

from enum import Enum, StrEnum
from typing import Final

from firmware_bridge.state_table import Row, StateTable


class Phase(Enum):
    """The state of a face as its supervisor sees it, in words for clients while no bridge answers.

    A stop that a person requested is kept beside it: `Requested`.
    """

    WAITING = "the bridge is down and starts again"
    STARTING = "the bridge starts"
    RETURNING = "the bridge starts again"  # since a person started the face
    RUNNING = "the bridge is being ended"  # it answers itself unless it hung
    RELEASING = "the bridge is down, torque is being switched off"
    GIVING_UP = "the bridge is down for good, torque is being switched off"
    STOPPED = "stopped"  # limp, until a person starts the face
    OVER = "ended"


class SupervisorEvent(StrEnum):
    """What happens to a face, as seen by its supervisor."""

    DUE = "due"  # the bridge may be started
    READY = "ready"  # the bridge has come up: every servo is driven, or named with the reason
    ENDED_WELL = "bridge ended"  # as it was told to, and every servo confirmed
    DIED = "bridge died"  # by a signal
    FAILED = "bridge failed"  # with an error
    HOPELESS = "bridge gave up"  # starting it again would not help
    RELEASED = "released"  # torque off is confirmed, or was sent for long enough
    PORT_STUCK = "port stuck"  # it could not be opened for longer than is waited for it
    FREEZE = "freeze"
    STOP = "stop"  # soft or limp
    SIGNAL = "signal"
    START = "start"
    AGAIN = "again"  # servos that did not confirm a stop are to be let go once more


class Requested(StrEnum):
    """The conditions of rows: which request of a person was the last, and is still in force."""

    END = "a stop that ends the process, or a signal"
    STOP = "a stop"
    FREEZE = "a freeze"
    FIRST = "nothing yet: the bridge has never been ready"
    KEPT = "a stop that is over, and the process goes on"


class SupervisorAction(StrEnum):
    """What is done about an event, besides the new phase."""

    START_BRIDGE = "start the bridge"
    START_ANEW = "forget the stop, start the bridge"
    KILL_BRIDGE = "kill the bridge"  # one that starts knows of no stop
    LET_GO = "switch torque off at the port"
    DROP_RELEASE = "leave torque as it is"
    STOP_SINCE_FAILED = "stop, since the start failed"
    TELL_READY = "tell systemd: ready"
    TELL_STOPPED = "report the end of the stop"
    TELL_END = "report the end"


_P, _E, _A = Phase, SupervisorEvent, SupervisorAction
_ALIVE: Final = (_P.STARTING, _P.RETURNING, _P.RUNNING)
_DOWN: Final = (_P.RELEASING, _P.GIVING_UP)
_FAILURES: Final = (_E.FAILED, _E.HOPELESS)
SUPERVISOR_TABLE: Final = StateTable[Phase, SupervisorEvent, Requested, SupervisorAction](
    (
        # A stop of an earlier process holds: its servos are let go before anything else.
        Row((_P.WAITING,), _E.DUE, _P.RELEASING, (_A.LET_GO,), when=Requested.STOP),
        Row((_P.WAITING,), _E.DUE, _P.STARTING, (_A.START_BRIDGE,)),
        Row(_ALIVE, _E.READY, _P.RUNNING, (_A.TELL_READY,)),
        *(Row(_ALIVE, each, _P.RELEASING, (_A.LET_GO,), when=Requested.STOP) for each in _FAILURES),
        # What is held stays held.
        Row(_ALIVE, _E.DIED, _P.WAITING, when=Requested.FREEZE),
        Row(_ALIVE, _E.DIED, _P.RELEASING, (_A.LET_GO,)),
        Row((_P.RETURNING,), _E.FAILED, _P.RELEASING, (_A.STOP_SINCE_FAILED, _A.LET_GO)),
        Row((_P.RETURNING,), _E.HOPELESS, _P.RELEASING, (_A.STOP_SINCE_FAILED, _A.LET_GO)),
        Row((_P.STARTING, _P.RUNNING), _E.FAILED, _P.WAITING, when=Requested.FREEZE),
        Row((_P.STARTING,), _E.FAILED, _P.GIVING_UP, (_A.LET_GO,), when=Requested.FIRST),
        Row((_P.STARTING, _P.RUNNING), _E.FAILED, _P.RELEASING, (_A.LET_GO,)),
        Row((_P.STARTING, _P.RUNNING), _E.HOPELESS, _P.GIVING_UP, (_A.LET_GO,)),
        Row(_ALIVE, _E.ENDED_WELL, _P.OVER, (_A.TELL_END,), when=Requested.END),
        Row(_ALIVE, _E.ENDED_WELL, _P.STOPPED, (_A.TELL_STOPPED,), when=Requested.STOP),
        Row(_ALIVE, _E.ENDED_WELL, _P.OVER, (_A.TELL_END,)),
        Row(_DOWN, _E.RELEASED, _P.OVER, (_A.TELL_END,), when=Requested.END),
        Row(_DOWN, _E.RELEASED, _P.STOPPED, (_A.TELL_STOPPED,), when=Requested.STOP),
        Row((_P.RELEASING,), _E.RELEASED, _P.WAITING, (_A.DROP_RELEASE,)),
        Row((_P.GIVING_UP,), _E.RELEASED, _P.OVER, (_A.TELL_END,)),
        Row(_DOWN, _E.PORT_STUCK, _P.OVER, (_A.TELL_END,), when=Requested.END),
        Row(_DOWN, _E.PORT_STUCK, _P.STOPPED, (_A.TELL_STOPPED,), when=Requested.STOP),
        Row(_DOWN, _E.PORT_STUCK, _P.OVER, (_A.TELL_END,)),
        Row(_ALIVE, _E.FREEZE, None, (_A.KILL_BRIDGE,)),
        Row(_ALIVE, _E.STOP, None, (_A.KILL_BRIDGE,)),
        # Whatever still holds is held, by the next bridge.
        Row((_P.RELEASING,), _E.FREEZE, _P.WAITING, (_A.DROP_RELEASE,), when=Requested.FREEZE),
        Row((_P.GIVING_UP,), _E.STOP, _P.RELEASING),
        Row((_P.WAITING,), _E.STOP, _P.RELEASING, (_A.LET_GO,)),
        Row((_P.WAITING,), _E.SIGNAL, _P.RELEASING, (_A.LET_GO,)),
        Row((_P.STOPPED,), _E.STOP, _P.OVER, (_A.TELL_END,), when=Requested.END),
        Row((_P.STOPPED,), _E.STOP, _P.RELEASING, (_A.LET_GO,)),
        Row((_P.STOPPED,), _E.SIGNAL, _P.OVER, (_A.TELL_END,)),
        Row((_P.STOPPED,), _E.AGAIN, _P.RELEASING, (_A.LET_GO,)),
        Row(
            (_P.STOPPED, _P.RELEASING),
            _E.START,
            _P.RETURNING,
            (_A.DROP_RELEASE, _A.START_ANEW),
            when=Requested.KEPT,
        ),
    )
)
