"""The expression of a face as its YAML asks for it.

A model learned from tracks is played by lipservo-lab: the entry point `lipservo.expressions`.
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import cast

from lipservo.settings.settings import FaceSettings
from lipservo.speech.expression_layer import ExpressionLayer
from lipservo.speech.expression_servos import expression_servos
from lipservo.speech.expression_wishes import ExpressionWishes
from lipservo.speech.heard_voice import HeardVoice
from lipsync.errors import UserError
from lipsync.expression.cue import WholeExpression
from lipsync.expression.live_expression import LiveExpression
from lipsync.prosody.voice_tracker import VoiceTracker


def check_expression(face: FaceSettings, folder: Path | None) -> None:
    """Refuse now what `make_expression` would refuse later. Raises ExpressionModelError."""
    if face.expression.model is not None:
        expression_source(face, folder, face.expression.seed)


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
    return _player_of_models()((folder or Path()) / asked.model, seed, source)


def _player_of_models() -> Callable[[Path, int, WholeExpression], WholeExpression]:
    """What plays a learned model in place of a source. Raises UserError without lipservo-lab."""
    for point in entry_points(group="lipservo.expressions"):
        return cast(Callable[[Path, int, WholeExpression], WholeExpression], point.load())
    raise UserError(
        "expression: {model: ...} needs lipservo-lab, which is not installed: "
        "`pip install lipservo-lab`, or remove the key"
    )


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
