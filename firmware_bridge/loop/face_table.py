"""The states of a face, and what each event does in each: the table of `Bridge`."""

from enum import StrEnum
from typing import Final

from firmware_bridge.state_table import Row, StateTable


class FaceState(StrEnum):
    """The state of a face: limp, being started, driven, frozen, or on its way to limp."""

    STOPPED = "stopped"  # limp until it is started
    STARTING = "starting"  # torque comes on, servo by servo
    DRIVEN = "driven"  # follows its targets, as many servos as are well
    SILENT = "silent"  # limp since speech fell silent; driven again at the next fresh target
    EASING = "easing"  # stopped by a person, on its way to rest
    FROZEN = "frozen"  # stopped by a person: what holds is held, nothing else gets torque
    LETTING_GO = "letting go"  # torque goes off, again and again until every servo confirms
    ENDED = "ended"  # limp, as far as the servos said so


class FaceEvent(StrEnum):
    """What happens to a face."""

    START = "start"
    STARTED = "started"  # the start is through: every servo is armed, or left to the ticks
    NOT_STARTED = "start failed"
    KEEP = "keep"  # started as a face that was frozen in an earlier process
    SOFT = "soft stop"
    FREEZE = "freeze"
    LIMP = "limp"
    STALE = "targets too old"
    TARGET = "fresh target"
    ARRIVED = "at rest"  # the way to rest is over
    ALL_OFF = "all off"  # torque off is confirmed by every servo, or was tried for 2 s
    WAIT = "wait"  # the stop is over, and the face waits for a start
    PORT_LOST = "port lost"
    PORT_BACK = "port back"


class FaceGuard(StrEnum):
    """The conditions that some rows of `FACE_TABLE` have."""

    CAN_EASE = "a servo is driven and the port is open"


class FaceAction(StrEnum):
    """What is done about an event, besides the new state."""

    ALLOW_TORQUE = "allow torque"
    FORBID_TORQUE = "forbid torque"  # until a person starts the face
    BEGIN = "begin where the servos stand"
    HOLD = "hold each servo that holds where it is"
    KEEP_HOLDING = "hold what still holds"
    LET_GO = "torque off"
    COUNT_START = "count a start"
    LEAVE_PORT = "let go at the other ports"
    LEAVE_PORT_HELD = "hold at the other ports"


_S, _E, _A = FaceState, FaceEvent, FaceAction
_LIMP_OR_DRIVEN: Final = (_S.STOPPED, _S.STARTING, _S.DRIVEN, _S.SILENT)
_STOP: Final = (_A.FORBID_TORQUE, _A.LET_GO)
#: LETTING_GO and ENDED know no stop: nothing goes further.
FACE_TABLE: Final = StateTable[FaceState, FaceEvent, FaceGuard, FaceAction](
    (
        Row((_S.STOPPED,), _E.START, _S.STARTING, (_A.ALLOW_TORQUE,)),
        Row((_S.FROZEN,), _E.START, _S.DRIVEN, (_A.BEGIN, _A.ALLOW_TORQUE, _A.COUNT_START)),
        Row((_S.STARTING,), _E.STARTED, _S.DRIVEN, (_A.BEGIN, _A.COUNT_START)),
        Row((_S.STARTING,), _E.NOT_STARTED, _S.STOPPED, (_A.LET_GO,)),
        Row((_S.STOPPED,), _E.KEEP, _S.FROZEN, (_A.FORBID_TORQUE, _A.BEGIN, _A.KEEP_HOLDING)),
        Row((_S.STOPPED,), _E.FREEZE, None, (_A.FORBID_TORQUE,)),  # nothing is held
        Row(
            (_S.STARTING, _S.DRIVEN, _S.SILENT, _S.EASING),
            _E.FREEZE,
            _S.FROZEN,
            (_A.FORBID_TORQUE, _A.HOLD),
        ),
        Row((_S.DRIVEN,), _E.SOFT, _S.EASING, (_A.FORBID_TORQUE,), when=FaceGuard.CAN_EASE),
        Row((*_LIMP_OR_DRIVEN, _S.FROZEN), _E.SOFT, _S.LETTING_GO, _STOP),
        Row((*_LIMP_OR_DRIVEN, _S.EASING, _S.FROZEN), _E.LIMP, _S.LETTING_GO, _STOP),
        Row((_S.DRIVEN,), _E.STALE, _S.SILENT, (_A.LET_GO,)),
        Row((_S.SILENT,), _E.TARGET, _S.DRIVEN, (_A.COUNT_START,)),
        Row((_S.EASING,), _E.ARRIVED, _S.LETTING_GO, (_A.LET_GO,)),
        Row((_S.LETTING_GO,), _E.ALL_OFF, _S.ENDED),
        Row((_S.ENDED,), _E.WAIT, _S.STOPPED),
        Row((_S.EASING,), _E.PORT_LOST, _S.LETTING_GO, (_A.LEAVE_PORT,)),
        Row((_S.FROZEN,), _E.PORT_LOST, None, (_A.LEAVE_PORT_HELD,)),
        Row((*_LIMP_OR_DRIVEN, _S.LETTING_GO, _S.ENDED), _E.PORT_LOST, None, (_A.LEAVE_PORT,)),
        Row((_S.FROZEN,), _E.PORT_BACK, None, (_A.KEEP_HOLDING,)),
        Row((_S.DRIVEN,), _E.PORT_BACK, None, (_A.LET_GO, _A.COUNT_START)),
        Row((_S.STOPPED, _S.SILENT, _S.LETTING_GO, _S.ENDED), _E.PORT_BACK, None, (_A.LET_GO,)),
    )
)
