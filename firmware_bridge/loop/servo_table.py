"""What each event does to one servo, by its state: the table of `ServoSupervision`."""

from enum import StrEnum
from typing import Final

from firmware_bridge.bus import ServoState
from firmware_bridge.state_table import Row, StateTable


class ServoEvent(StrEnum):
    """What happens to one servo; the first ten are read from it in a tick."""

    SILENT = "silent"  # it has not answered for half a second
    ERROR = "hardware error"
    HOT = "too hot"
    BEHIND = "does not follow"
    TRIPPED = "watchdog tripped"
    TORQUE_LOST = "torque lost"  # its torque is read off
    STILL_ON = "still on"  # its torque is read on although it was switched off
    COOLED = "cooled down"
    STILL_FAULTY = "error stays"
    READY = "ready"  # it answers, has no error, and may have torque
    DUE = "due"  # torque off is to be sent once more
    ENABLED = "enabled"  # it confirmed torque on
    REFUSED = "refused"  # it did not
    CONFIRMED = "confirmed off"
    ALL_OFF = "all off"  # the whole face was let go, or its port is lost
    SWITCH_OFF = "servo off"  # a person
    SWITCH_ON = "servo on"
    REBOOT = "servo reboot"


class ServoGuard(StrEnum):
    """The conditions that some rows of `SERVO_TABLE` have."""

    FAILED_OFTEN = "the fourth time in ten minutes"


class ServoAction(StrEnum):
    """What is done about an event, besides the new state."""

    DISABLE = "torque off"
    ENABLE = "torque on"
    REBOOT = "restart it"
    COUNT = "count a failure"
    GIVE_UP = "give it up"  # no torque until a person switches it on or starts the face
    FORGET_FAILURES = "forget failures"


_S, _E, _A, _G = ServoState, ServoEvent, ServoAction, ServoGuard
_OFF: Final = (_S.SWITCHING_OFF, _S.OFF)
_ON_ITS_WAY: Final = (_S.WAITING, _S.REBOOTING)
_NOT_OFF: Final = (_S.DRIVEN, _S.WAITING, _S.COOLING, _S.REBOOTING)
SERVO_TABLE: Final = StateTable[ServoState, ServoEvent, ServoGuard, ServoAction](
    (
        Row((_S.DRIVEN, *_ON_ITS_WAY), _E.SILENT, _S.WAITING),
        Row((_S.DRIVEN,), _E.ERROR, _S.COOLING, (_A.DISABLE,)),
        Row(_ON_ITS_WAY, _E.ERROR, _S.COOLING),
        Row((_S.DRIVEN,), _E.HOT, _S.COOLING, (_A.DISABLE,)),
        Row(
            (_S.DRIVEN,),
            _E.BEHIND,
            _S.FAILED,
            (_A.DISABLE, _A.GIVE_UP),
            when=_G.FAILED_OFTEN,
        ),
        Row((_S.DRIVEN,), _E.BEHIND, _S.COOLING, (_A.DISABLE, _A.COUNT)),
        Row((_S.DRIVEN,), _E.TRIPPED, _S.WAITING),
        Row((_S.DRIVEN,), _E.TORQUE_LOST, _S.WAITING),
        Row(_ON_ITS_WAY, _E.READY, _S.WAITING, (_A.ENABLE,)),
        # A frozen face keeps torque that it finds, of a servo that was given up, too.
        Row((*_NOT_OFF, _S.FAILED), _E.ENABLED, _S.DRIVEN),
        Row(_NOT_OFF, _E.REFUSED, _S.WAITING),
        Row((_S.COOLING,), _E.COOLED, _S.WAITING),
        Row((_S.COOLING,), _E.STILL_FAULTY, _S.FAILED, (_A.GIVE_UP,), when=_G.FAILED_OFTEN),
        Row((_S.COOLING,), _E.STILL_FAULTY, _S.REBOOTING, (_A.COUNT, _A.REBOOT)),
        Row((_S.COOLING, _S.FAILED), _E.STILL_ON, None, (_A.DISABLE,)),
        Row((_S.OFF,), _E.STILL_ON, _S.SWITCHING_OFF, (_A.DISABLE,)),
        Row((_S.SWITCHING_OFF,), _E.DUE, _S.SWITCHING_OFF, (_A.DISABLE,)),
        Row((_S.SWITCHING_OFF,), _E.CONFIRMED, _S.OFF),
        Row(_NOT_OFF, _E.ALL_OFF, _S.WAITING),
        # What it confirmed before may not be so any more.
        Row(_OFF, _E.ALL_OFF, _S.SWITCHING_OFF),
        Row((*_NOT_OFF, _S.FAILED, *_OFF), _E.SWITCH_OFF, _S.SWITCHING_OFF),
        Row((*_OFF, _S.FAILED), _E.SWITCH_ON, _S.WAITING, (_A.FORGET_FAILURES,)),
        Row((_S.WAITING, _S.COOLING, _S.REBOOTING), _E.REBOOT, _S.REBOOTING, (_A.REBOOT,)),
        Row((_S.FAILED,), _E.REBOOT, None, (_A.REBOOT,)),
        Row(_OFF, _E.REBOOT, _S.SWITCHING_OFF, (_A.REBOOT,)),
    )
)
