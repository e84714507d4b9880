"""A moment as a JSON array, for programs: what `/api/state` sends, names said once before."""

import json

from lipservo.dashboard.moments import Moment
from lipservo.dashboard.twin_frame import (
    ABSENT,
    RATE_HZ,
    SERVOS_GONE,
    SPEECH_GONE,
    UNKNOWN,
    VERSION,
    arousal_of,
    encoders_of,
    expression_of,
    flags_of,
    goals_of,
    phoneme_of,
    state_of,
)
from lipservo.status.live_board import EXPRESSION_NAMES, BoardLayout

#: What stands where in an array.
FIELDS = (
    "number", "time_ms", "state", "phoneme", "flags", "arousal_percent", "goals_tenths_deg",
    "encoders_tenths_deg", "expression",
)  # fmt: skip


def state_hello(layout: BoardLayout) -> str:
    """What is said once: fields of an array, and the names that they count by."""
    return json.dumps(
        {
            "version": VERSION,
            "name": layout.name,
            "fields": FIELDS,
            "servos": layout.servos,
            "states": layout.states,
            "phonemes": layout.phonemes,
            "expression": EXPRESSION_NAMES,
            "flags": {
                "torque_on": 1, "servos_gone": SERVOS_GONE, "speech_gone": SPEECH_GONE,
                "cut_off": 8, "speaking": 16,
            },
            "rate_hz": RATE_HZ,
        }
    )  # fmt: skip


def state_message(moment: Moment, layout: BoardLayout) -> str:
    """One array; null: not known. Expression: hundredths, angles in tenths of a degree."""
    expression = [
        None if value == ABSENT else round(value / (10 if name.endswith("_deg") else 100))
        for name, value in zip(EXPRESSION_NAMES, expression_of(moment).tolist(), strict=True)
    ]
    state, phoneme = state_of(moment, layout), phoneme_of(moment, layout)
    values = [
        moment.number,
        round(1e3 * moment.time_s),
        None if state == UNKNOWN else state,
        None if phoneme == UNKNOWN else phoneme,
        flags_of(moment),
        round(100 * arousal_of(moment)),
        _known(goals_of(moment, layout, 10.0).tolist()),
        _known(encoders_of(moment, layout, 10.0).tolist()),
        expression,
    ]
    return json.dumps(values, separators=(",", ":"))


def _known(values: list[int]) -> list[int | None]:
    return [None if value == ABSENT else value for value in values]
