"""Motion learned from tracks: in conversation only, without a step, by the face's YAML."""

from dataclasses import astuple

import numpy as np
import pytest
from expression_tracks import small_model
from lipservo_lab.learning.learned_expression.expression_model import (
    ExpressionModelError,
    save_expression,
)
from lipservo_lab.learning.learned_expression.learned_expression import LearnedHead

from lipservo.runtime.speech.expression import make_expression
from lipservo.settings.settings import load_shipped_face
from lipsync.expression.cue import ExpressionCue
from lipsync.face.frame import Expression


class Steady:
    """Shows the same, always."""

    def __init__(self, expression):
        self.expression = expression
        self.is_resting = False

    def step(self, _cue):
        return self.expression


PLAIN = Steady(Expression(1.0, 1.0, 1.0, 1.0, 1.0, 0.1, 0.1, 0.5, 0.7, 0.0))
LEARNED = Steady(Expression(9.0, 9.0, 9.0, None, None, 0.3, 0.3))


def shown(cues):
    head = LearnedHead(LEARNED, PLAIN)
    return np.array([astuple(head.step(cue)) for cue in cues], dtype=float)


def test_in_conversation_the_head_is_learned_and_what_tracks_do_not_tell_is_as_ever():
    last = shown([ExpressionCue(0.0, is_speaking=True)] * 200)[-1]
    assert last.tolist() == pytest.approx([9.0, 9.0, 9.0, 1.0, 1.0, 0.3, 0.3, 0.5, 0.7, 0.0])


@pytest.mark.parametrize(
    "otherwise",
    [ExpressionCue(0.0, silent_s=5.0), ExpressionCue(0.0, silent_s=0.0, look_at_deg=(10.0, 0.0))],
)
def test_idle_and_looking_at_somebody_are_as_ever_and_nothing_jumps_on_the_way(otherwise):
    speaking = ExpressionCue(0.0, is_speaking=True)
    path = shown([speaking] * 200 + [otherwise] * 200)
    assert path[-1].tolist() == list(astuple(PLAIN.expression))
    assert np.abs(np.diff(path, axis=0)).max() < 0.15


def test_the_yaml_names_the_model_from_its_own_folder(tmp_path):
    save_expression(small_model(), tmp_path / "head.npz")
    head = load_shipped_face("face_head")
    asked = head.expression.model_copy(update={"model": "head.npz"})
    face = head.model_copy(update={"expression": asked})

    layer = make_expression(face, tmp_path, is_watched=True)
    for _ in range(300):
        layer.advance(0.0, 0.0, is_speaking=True)
    assert abs(layer.expression.neck_yaw_deg) > 0.0
    with pytest.raises(ExpressionModelError, match=r"head\.npz: no such file"):
        make_expression(face, tmp_path / "elsewhere", is_watched=True)
