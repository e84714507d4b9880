"""The words of the control socket that change something: into the queue, and what is answered.

set NAME VALUE [NAME VALUE ...]     servo NAME off|on|reboot     jog arm | NAME DEG | end
"""

from collections.abc import Callable
from typing import Final

from firmware_bridge.orders import ArmJog, EndJog, JogTo, ServoOrder, ServoSwitch
from firmware_bridge.process.command_queue import CommandError, CommandQueue

#: The first words of the commands.
SET_WORD: Final = "set"
SERVO_WORD: Final = "servo"
JOG_WORD: Final = "jog"
ARM_WORD: Final = "arm"
END_WORD: Final = "end"
START_WORD: Final = "start"

_SAY_SET: Final = "say: set NAME VALUE [NAME VALUE ...]"
_SAY_SERVO: Final = "say: servo NAME off|on|reboot"
_SAY_JOG: Final = "say: jog arm, jog NAME DEG, or jog end"


def command_answer(
    word: str, commands: CommandQueue, asked_by: Callable[[], str]
) -> dict[str, object] | None:
    """What is answered to `word`, which is in `commands` now; None: it is no command of these.

    asked_by: who asks, for a log.
    """
    first, *rest = word.split()
    try:
        if first == SET_WORD:
            return _set(rest, commands)
        if first == SERVO_WORD:
            return _switch(rest, commands, asked_by)
        if first == JOG_WORD:
            return _jog(rest, commands)
    except CommandError as error:
        return {"error": str(error)}
    return None


def _set(words: list[str], commands: CommandQueue) -> dict[str, object]:
    if not words or len(words) % 2:
        raise CommandError(_SAY_SET)
    names = words[::2]
    if len(set(names)) < len(names):
        raise CommandError("a setting is named twice")
    values = {name: _number(text) for name, text in zip(names, words[1::2], strict=True)}
    commands.change(values)
    if len(names) == 1:
        return {"set": names[0], "value": values[names[0]]}
    return {"set": values}


def _switch(
    words: list[str], commands: CommandQueue, asked_by: Callable[[], str]
) -> dict[str, object]:
    if len(words) != 2 or words[1] not in set(ServoSwitch):
        raise CommandError(_SAY_SERVO)
    name, switch = words
    commands.order(ServoOrder(name, ServoSwitch(switch), asked_by()))
    return {"servo": name, "asked": switch}


def _jog(words: list[str], commands: CommandQueue) -> dict[str, object]:
    match words:
        case [word] if word == ARM_WORD:
            commands.order(ArmJog())
            return {"jog": ARM_WORD}
        case [word] if word == END_WORD:
            commands.order(EndJog())
            return {"jog": END_WORD}
        case [name, angle]:
            position_deg = _number(angle)
            commands.order(JogTo(name, position_deg))
            return {"jog": name, "position_deg": position_deg}
    raise CommandError(_SAY_JOG)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise CommandError(f"{text[:40]!r} is not a number") from None
