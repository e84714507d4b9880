"""The course of a face in one process, from start to end: the table of `LifeCycle`."""

from enum import StrEnum
from typing import Final

from firmware_bridge.state_table import Row, StateTable


class LifeState(StrEnum):
    """Where a face is between its first torque and its last, and what follows a stop."""

    NOT_STARTED = "not started"
    STARTING = "starting"
    RUNNING = "running"
    FROZEN = "frozen"  # by a person, until a start or a stop that goes further
    STOPPING = "stopping"  # on its way to limp, where it waits for a start
    WAITING = "waiting"  # limp, for a start
    ENDING = "ending"  # on its way to limp, where the ticks end
    LEAVING = "leaving"  # the same by a signal or the program's end: a lost port is waited for 30 s
    FROZEN_LAST = "frozen at the end"  # by a person, and the program is over: until a stop
    DISABLING = "disabling"  # torque off now, whatever the program was doing
    OVER = "over"


class LifeEvent(StrEnum):
    """The events that may change the `LifeState` of a face."""

    START = "start"
    STARTED = "started"
    NOT_STARTED = "start failed"
    KEEP = "start frozen"
    FREEZE = "freeze"
    STOP = "stop"  # soft or limp
    STOP_AND_END = "stop and end"
    SIGNAL = "signal"
    PROGRAM_END = "program's end"
    LIMP = "limp"  # the face is limp, as far as its servos said so
    GIVE_UP = "port is lost"  # for longer than it is waited for
    DISABLE = "disable"  # a second signal, or an error of servos or port
    LEFT = "left"  # the program goes on without the face


class LifeGuard(StrEnum):
    """The conditions that some rows of `LIFE_TABLE` have."""

    WAITS = "the process waits for a start"
    CAN_FREEZE = "not yet being let go"


class LifeAction(StrEnum):
    """What is done about an event, besides the new state."""

    ARM = "start the servos"
    ARM_AGAIN = "start the servos, failed ones too"
    KEEP = "hold what holds"
    STOP = "stop the servos"  # at the level of the request
    STOP_SOFTLY = "stop the servos softly"
    LET_GO = "let go"
    TELL_WAITING = "report the end of the stop"


_S, _E, _A, _G = LifeState, LifeEvent, LifeAction, LifeGuard
_LIVE: Final = (_S.STARTING, _S.RUNNING, _S.FROZEN)
_ENDS: Final = (_S.ENDING, _S.LEAVING)
_MAY_WAIT: Final = (_S.NOT_STARTED, *_LIVE, _S.STOPPING, _S.WAITING)
_LIVES_ON: Final = (*_MAY_WAIT, _S.ENDING, _S.FROZEN_LAST)
LIFE_TABLE: Final = StateTable[LifeState, LifeEvent, LifeGuard, LifeAction](
    (
        Row((_S.NOT_STARTED,), _E.START, _S.STARTING, (_A.ARM,)),
        Row((_S.WAITING, _S.FROZEN), _E.START, _S.STARTING, (_A.ARM_AGAIN,)),
        Row((_S.STARTING,), _E.STARTED, _S.RUNNING),
        Row((_S.STARTING,), _E.NOT_STARTED, _S.STOPPING, (_A.LET_GO,), when=_G.WAITS),
        Row((_S.STARTING,), _E.NOT_STARTED, _S.ENDING, (_A.LET_GO,)),
        Row((_S.NOT_STARTED,), _E.KEEP, _S.FROZEN, (_A.KEEP,)),
        Row(_LIVE, _E.FREEZE, _S.FROZEN, (_A.STOP,)),
        Row((_S.STOPPING,), _E.FREEZE, _S.FROZEN, (_A.STOP,), when=_G.CAN_FREEZE),
        # It is held on its way to rest; the next stop still ends it.
        Row(_ENDS, _E.FREEZE, None, (_A.STOP,), when=_G.CAN_FREEZE),
        Row(_MAY_WAIT, _E.STOP, _S.STOPPING, (_A.STOP,), when=_G.WAITS),
        Row(_MAY_WAIT, _E.STOP, _S.ENDING, (_A.STOP,)),
        Row(_ENDS, _E.STOP, None, (_A.STOP,)),
        Row((*_MAY_WAIT, _S.ENDING), _E.STOP_AND_END, _S.ENDING, (_A.STOP,)),
        Row((_S.LEAVING,), _E.STOP_AND_END, None, (_A.STOP,)),
        Row((_S.FROZEN_LAST,), _E.STOP, _S.LEAVING, (_A.STOP,)),
        Row((_S.FROZEN_LAST,), _E.STOP_AND_END, _S.LEAVING, (_A.STOP,)),
        Row(_LIVES_ON, _E.SIGNAL, _S.LEAVING, (_A.STOP_SOFTLY,)),
        Row((_S.LEAVING,), _E.SIGNAL, None, (_A.STOP_SOFTLY,)),
        # The end of a program undoes no person's freeze.
        Row((_S.FROZEN,), _E.PROGRAM_END, _S.FROZEN_LAST),
        Row((_S.STARTING, _S.RUNNING), _E.PROGRAM_END, _S.LEAVING, (_A.STOP,)),
        Row((_S.STOPPING, _S.ENDING), _E.PROGRAM_END, _S.LEAVING),
        Row((_S.STOPPING,), _E.LIMP, _S.WAITING, (_A.TELL_WAITING,)),
        # By itself, or frozen too late: it was being let go for a critical servo already.
        Row((*_LIVE, _S.FROZEN_LAST, *_ENDS), _E.LIMP, _S.OVER),
        Row((_S.LEAVING,), _E.GIVE_UP, _S.OVER),
        Row((*_LIVES_ON, _S.LEAVING, _S.OVER), _E.DISABLE, _S.DISABLING),
        Row((*_LIVES_ON, _S.LEAVING, _S.DISABLING), _E.LEFT, _S.OVER),
    )
)
#: No stop was requested since the last start.
NOT_STOPPED: Final = (_S.NOT_STARTED, _S.STARTING, _S.RUNNING)
#: A further signal has nothing to hurry there.
HURRIED: Final = (_S.DISABLING, _S.OVER)
