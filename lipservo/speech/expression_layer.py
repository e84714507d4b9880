"""Head, eyes, lids, brows and a smile of a face that speaks: what it claims of the servos."""

from collections.abc import Mapping, Sequence
from typing import Final

from lipservo.speech.expression_servos import ExpressionClaims, ExpressionServo
from lipservo.speech.expression_wishes import ExpressionWishes
from lipservo.speech.heard_voice import HeardVoice
from lipservo.speech.layers import Claim, Layer
from lipsync.expression.affect import mouth_gain
from lipsync.expression.cue import CUE_PERIOD_S, ExpressionCue, WholeExpression
from lipsync.expression.performed_expression import PerformedExpression
from lipsync.face.frame import NO_EXPRESSION, Expression

#: A pause within a sentence: whoever makes it still speaks.
_PAUSE_S: Final = 0.3
#: After so long a silence what the head does is nobody's business but its own.
_IDLE_AFTER_S: Final = 4.0


class ExpressionLayer:
    """`advance` once for every 10 ms that are shown, then `claims`."""

    def __init__(
        self,
        source: WholeExpression,
        voice: HeardVoice,
        servos: Sequence[ExpressionServo],
        wishes: ExpressionWishes,
    ) -> None:
        self.voice = voice
        self._source = source
        self._claims = ExpressionClaims(servos, CUE_PERIOD_S)
        self.wishes = wishes
        self._performed = PerformedExpression()
        self._n_steps = 0
        self._silent_s = 0.0
        self._arousal = 0.0
        self._is_speaking = False
        #: What is shown now.
        self.expression: Expression = NO_EXPRESSION

    @property
    def is_resting(self) -> bool:
        """Whether it is at neutral after a long silence and stays there: servos may be let go."""
        return self._silent_s > _IDLE_AFTER_S and self._source.is_resting

    @property
    def arousal(self) -> float:
        """Of the voice that is shown now, and of what was set: -1 to 1."""
        return self._arousal

    @property
    def mouth_gain(self) -> float:
        """How much livelier the mouth moves for it. A face that is only a mouth moves as ever."""
        return mouth_gain(self._arousal) if self._claims.any_servos else 1.0

    def change(self, settings: Mapping[str, float]) -> None:
        """Take what was set, by the names of `ExpressionWishes`."""
        if self.wishes.change(settings):
            self.wake()

    def wake(self) -> None:
        """Something is about to happen: a face that rests gets up."""
        self._silent_s = 0.0

    def advance(
        self,
        sound_s: float,
        now_s: float,
        *,
        is_speaking: bool,
        performed: Expression = NO_EXPRESSION,
    ) -> None:
        """The next 10 ms, of what was heard at `sound_s`; shown at monotonic `now_s`.

        is_speaking: the mouth says a phoneme at that moment. performed: what a performance stores
        of it, which is shown in place of ours.
        """
        self._silent_s = 0.0 if is_speaking else self._silent_s + CUE_PERIOD_S
        self._is_speaking = self._silent_s < _PAUSE_S
        voice = self.voice.at(sound_s)
        valence, arousal = self.wishes.affect_at(now_s)
        self._arousal = min(1.0, max(-1.0, voice.arousal + arousal))
        self._n_steps += 1
        amount = self.wishes.amount
        live = self._source.step(
            ExpressionCue(
                time_s=self._n_steps * CUE_PERIOD_S,
                voice=voice,
                is_speaking=self._is_speaking,
                silent_s=self._silent_s,
                look_at_deg=self.wishes.look_at_deg,
                valence=valence,
                arousal=self._arousal,
                amount=amount,
            )
        )
        self.expression = self._performed.step(live, performed, amount)

    def claims(self, mouth: Claim) -> list[Claim]:
        """What lips and expression want. mouth: what the lips would have."""
        is_idle = self._silent_s > _IDLE_AFTER_S and self.wishes.look_at_deg is None
        claims = self._claims.claims(self.expression, Layer.IDLE if is_idle else Layer.EXPRESSION)
        if self._is_speaking:
            return [*claims, mouth]
        return [*claims, *self._claims.mouth(self.expression, mouth)]
