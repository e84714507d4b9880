"""The expression of a face as its YAML asks for it."""

from pathlib import Path

import numpy as np

from lipservo.settings.settings import FaceSettings
from lipservo.speech.expression_layer import ExpressionLayer
from lipservo.speech.expression_servos import expression_servos
from lipservo.speech.expression_wishes import ExpressionWishes
from lipservo.speech.heard_voice import HeardVoice
from lipservo.speech.learned_head import LearnedHead
from lipsync.expression.cue import WholeExpression
from lipsync.expression.learned.expression_model import load_expression
from lipsync.expression.learned.learned_expression import LearnedExpression
from lipsync.expression.live_expression import LiveExpression
from lipsync.prosody.voice_tracker import VoiceTracker


def check_expression(face: FaceSettings, folder: Path | None) -> None:
    """Refuse now what `make_expression` would refuse later. Raises ExpressionModelError."""
    if face.expression.model is not None:
        load_expression((folder or Path()) / face.expression.model)


def expression_source(face: FaceSettings, folder: Path | None, seed: int) -> WholeExpression:
    """Who makes the expressions of a face. Raises ExpressionModelError.

    folder: of the YAML, from which a learned model is named; None: a shipped face.
    """
    asked = face.expression
    # Of a face that its YAML lets look more or less often at whoever it speaks with.
    shares = {} if asked.eye_contact is None else {"talking_mutual_share": asked.eye_contact}
    source: WholeExpression = LiveExpression(seed, rest_after_s=asked.rest_after_s, **shares)
    if asked.model is None:
        return source
    model = load_expression((folder or Path()) / asked.model)
    return LearnedHead(LearnedExpression(model, np.random.default_rng(seed)), source)


def make_expression(face: FaceSettings, folder: Path | None) -> ExpressionLayer:
    """Everything between the sound that is heard and the servos besides the mouth.

    folder: as `expression_source` has it. Raises ExpressionModelError for a model that cannot be
    used.
    """
    return ExpressionLayer(
        expression_source(face, folder, face.expression.seed),
        HeardVoice(VoiceTracker()),
        expression_servos(face),
        ExpressionWishes(face.expression.amount),
    )
