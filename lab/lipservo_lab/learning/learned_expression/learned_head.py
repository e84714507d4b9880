"""Motion learned from tracks while there is a conversation; everything else as without it."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from lipservo_lab.learning.learned_expression.expression_model import load_expression
from lipservo_lab.learning.learned_expression.learned_expression import LearnedExpression
from lipsync.expression.bounded import smoothstep, toward
from lipsync.expression.cue import CUE_PERIOD_S, ExpressionCue, ExpressionSource, WholeExpression
from lipsync.face.frame import Expression

#: What tracks tell; brow and smile they do not.
_LEARNED: Final = (
    "neck_pitch_deg", "neck_yaw_deg", "neck_roll_deg", "eye_pitch_deg", "eye_yaw_deg",
    "lid_left", "lid_right",
)  # fmt: skip
#: A conversation is over after so long a silence.
_CONVERSATION_S: Final = 4.0
#: From one to the other: slower than any motion of either.
_OVER_S: Final = 1.0


class LearnedHead:
    """A `WholeExpression` of two: `learned` in conversation, `otherwise` in all else.

    Idle motion, rest and looking at somebody are not in the tracks of a talking head.
    """

    def __init__(self, learned: ExpressionSource, otherwise: WholeExpression) -> None:
        self._learned = learned
        self._otherwise = otherwise
        self._share = 0.0

    @property
    def is_resting(self) -> bool:
        """Whether it is at neutral, and stays there until somebody speaks or moves."""
        return self._share == 0.0 and self._otherwise.is_resting

    def step(self, cue: ExpressionCue) -> Expression:
        """The expression of the cue's moment; call it once for each, in order."""
        plain, learned = self._otherwise.step(cue), self._learned.step(cue)
        is_talk = cue.silent_s < _CONVERSATION_S and cue.look_at_deg is None
        self._share = toward(self._share, float(is_talk), CUE_PERIOD_S / _OVER_S)
        share = smoothstep(self._share)
        if share == 0.0:
            return plain
        mixed = {}
        for name in _LEARNED:
            ours, theirs = getattr(plain, name), getattr(learned, name)
            if ours is not None and theirs is not None:
                mixed[name] = ours + share * (theirs - ours)
        return replace(plain, **mixed)


def learned_expression(path: Path, seed: int, otherwise: WholeExpression) -> WholeExpression:
    """What a face plays whose YAML names a learned model: the entry point `lipservo.expressions`.

    Raises
    ------
    ExpressionModelError
        For a file that holds no such model.

    """
    return LearnedHead(
        LearnedExpression(load_expression(path), np.random.default_rng(seed)), otherwise
    )
