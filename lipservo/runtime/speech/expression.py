"""The expression of a face that speaks: head, eyes, lids, brows and a smile.

The settings of it, the servos that show it, and the layer that claims those servos. The head and
eyes of a performance replace the live ones.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from firmware_bridge.process.commands import Setting
from lipservo.runtime.speech.layers import Claim, Indices, Layer
from lipservo.runtime.speech.phoneme_sources import HeardVoice
from lipservo.settings.sections import LIVELIEST, ExpressionSettings
from lipservo.settings.settings import FaceSettings
from lipsync.expression.cue import (
    CUE_PERIOD_S,
    ExpressionCue,
    ExpressionSource,
    smoothstep,
    toward,
)
from lipsync.face.frame import NO_EXPRESSION, Expression
from lipsync.prosody.voice_tracker import VoiceTracker

#: Farther to the side than a person looks without turning round.
_FARTHEST_YAW_DEG: Final = 60.0
_FARTHEST_PITCH_DEG: Final = 40.0


def expression_settings(amount: float) -> dict[str, Setting]:
    """Return the settings of the expression that may change while a face runs, with their limits.

    amount: initial liveliness, 0 still, 1 as measured on people. look_weight: 1 = look at
    (look_yaw_deg, look_pitch_deg), 0 = at no target. The affect that a dialogue system sets fades
    with affect_tau_s from monotonic affect_at_s on.
    """
    return {
        "expression": Setting(amount, 0.0, LIVELIEST),
        "look_weight": Setting(0.0, 0.0, 1.0),
        "look_yaw_deg": Setting(0.0, -_FARTHEST_YAW_DEG, _FARTHEST_YAW_DEG),
        "look_pitch_deg": Setting(0.0, -_FARTHEST_PITCH_DEG, _FARTHEST_PITCH_DEG),
        "affect_valence": Setting(0.0, -1.0, 1.0),
        "affect_arousal": Setting(0.0, -1.0, 1.0),
        "affect_tau_s": Setting(10.0, 0.1, 600.0),
        "affect_at_s": Setting(0.0, 0.0, 1e9),  # of a computer that runs for thirty years
    }


class ExpressionRequests:
    """The values of the expression settings that were set last."""

    #: Names of the settings for a moment (where to look, mood), which no face's YAML sets.
    PASSING: Final = frozenset(expression_settings(0.0)) - {"expression"}

    def __init__(self, amount: float) -> None:
        self._values = {name: each.value for name, each in expression_settings(amount).items()}

    def change(self, settings: Mapping[str, float]) -> bool:
        """Store the known settings among `settings`; return whether any value has changed."""
        news = {
            name: value
            for name, value in settings.items()
            if name in self._values and value != self._values[name]
        }
        self._values.update(news)
        return bool(news)

    @property
    def values(self) -> dict[str, float]:
        """The values of all expression settings, by name."""
        return dict(self._values)

    @property
    def amount(self) -> float:
        """The liveliness of the expression: 0 still, 1 as measured on people."""
        return self._values["expression"]

    @property
    def look_at_deg(self) -> tuple[float, float] | None:
        """The (yaw, pitch) of the target to look at; None: no target."""
        if self._values["look_weight"] < 0.5:
            return None
        return self._values["look_yaw_deg"], self._values["look_pitch_deg"]

    def affect_at(self, now_s: float) -> tuple[float, float]:
        """Return the (valence, arousal) set last, faded exponentially to monotonic `now_s`."""
        values = self._values
        age_s = max(0.0, now_s - values["affect_at_s"])
        remaining = math.exp(-age_s / values["affect_tau_s"])
        return values["affect_valence"] * remaining, values["affect_arousal"] * remaining


#: Corners of the mouth that speech does not need move for a smile of at least so much.
_SMALLEST_SMILE = 0.02


@dataclass(frozen=True, slots=True)
class ExpressionServo:
    """A servo, by its number in the face, that shows a part of an expression.

    of: the part shown: a field of `Expression`, or `lids`. deg_per_unit: servo degrees for 1 of
    that part's unit. min_deg to max_deg: the servo's range.
    """

    index: int
    of: str
    deg_per_unit: float
    min_deg: float
    max_deg: float
    max_speed_deg_s: float
    is_mouth: bool


def expression_servos(face: FaceSettings) -> list[ExpressionServo]:
    """Return the servos that show a part of an expression (`expression:` in their YAML entry)."""
    return [
        ExpressionServo(
            index,
            servo.expression.of,
            servo.expression.deg_per_unit,
            servo.min_deg,
            servo.max_deg,
            servo.max_speed_deg_s,
            servo.part == "mouth",
        )
        for index, servo in enumerate(face.servos.values())
        if servo.expression is not None
    ]


class ExpressionClaims:
    """The claims of an expression on its servos, computed once each period.

    Lips have priority: the corners of the mouth smile only in silence, and move as the lips need
    from the next known word on, after the 0.3 s of every hand-over.
    """

    def __init__(self, servos: Sequence[ExpressionServo], period_s: float) -> None:
        """Start at neutral. period_s: seconds from one call of `claims` to the next."""
        self._head = [servo for servo in servos if not servo.is_mouth]
        self._corners = [servo for servo in servos if servo.is_mouth]
        self._head_indices = _indices(self._head)
        self._corner_indices = _indices(self._corners)
        self._most_steps_deg = np.array([servo.max_speed_deg_s * period_s for servo in self._head])
        self._shown_deg = np.zeros(len(self._head))

    def claims(self, expression: Expression, layer: Layer) -> list[Claim]:
        """Return goals for neck, eyes, lids, brows as `layer`'s claim; [] without such servos."""
        if not self._head:
            return []
        goals_deg = np.array([_goal_deg(servo, expression) for servo in self._head])
        # A saccade is faster than any servo: goals move no faster than the servos can follow.
        step_deg = np.clip(goals_deg - self._shown_deg, -self._most_steps_deg, self._most_steps_deg)
        self._shown_deg = self._shown_deg + step_deg
        return [Claim(layer, self._head_indices, self._shown_deg)]

    def mouth(self, expression: Expression, lips: Claim) -> list[Claim]:
        """Return the claims for a silent mouth: its lips as given, its corners moved by the smile.

        lips: claim of the lips at rest, returned alone without corner servos or smile.
        """
        smile = expression.smile or 0.0
        if not self._corners or abs(smile) < _SMALLEST_SMILE:
            return [lips]
        at_rest_deg = dict(zip(lips.servos.tolist(), lips.positions_deg.tolist(), strict=True))
        smiling_deg = [
            _within_range(servo, at_rest_deg[servo.index] + servo.deg_per_unit * smile)
            for servo in self._corners
        ]
        is_no_corner = ~np.isin(lips.servos, self._corner_indices)
        return [
            Claim(Layer.LIPS, lips.servos[is_no_corner], lips.positions_deg[is_no_corner]),
            Claim(Layer.EXPRESSION, self._corner_indices, np.array(smiling_deg)),
        ]


def _indices(servos: Sequence[ExpressionServo]) -> Indices:
    return np.array([servo.index for servo in servos], dtype=np.intp)


def _goal_deg(servo: ExpressionServo, expression: Expression) -> float:
    if servo.of == "lids":
        value = 0.5 * ((expression.lid_left or 0.0) + (expression.lid_right or 0.0))
    else:
        value = getattr(expression, servo.of) or 0.0
    return _within_range(servo, servo.deg_per_unit * value)


def _within_range(servo: ExpressionServo, angle_deg: float) -> float:
    return min(servo.max_deg, max(servo.min_deg, angle_deg))


#: Seconds in which each part fades between live and performed expression: a neck as in a slow turn,
#: eyes as in a large saccade, lids as in a blink, so that none is left half shut.
_FADES_S: Final = {
    "neck_pitch_deg": 0.8, "neck_yaw_deg": 0.8, "neck_roll_deg": 0.8,
    "eye_pitch_deg": 0.2, "eye_yaw_deg": 0.2,
    "lid_left": 0.1, "lid_right": 0.1, "brow": 0.3,
}  # fmt: skip
#: Seconds in which the amount (liveliness) changes by 1, as in `LiveExpression`.
_AMOUNT_S: Final = 1.0


class PerformedExpression:
    """A mixer of live expression and a performance's: call `step` once for every 10 ms shown."""

    def __init__(self) -> None:
        # By part: the performed share of what is shown, and the performed value shown last.
        self._shares = dict.fromkeys(_FADES_S, 0.0)
        self._stored = dict.fromkeys(_FADES_S, 0.0)
        self._amount = 0.0

    def step(self, live: Expression, stored: Expression, amount: float) -> Expression:
        """Return the live expression with the performed values faded in or out.

        stored: the performance's expression, `NO_EXPRESSION` where there is none. amount: how
        lively the face is to be; at 0 the performance is not shown. Where a performance ends or is
        cut off, its last pose fades to the live one.
        """
        self._amount = toward(self._amount, amount, CUE_PERIOD_S / _AMOUNT_S)
        is_still = amount <= 0.0
        mixed = {}
        for name, fade_s in _FADES_S.items():
            value = None if is_still or stored is NO_EXPRESSION else getattr(stored, name)
            # The amount scales the motion of a performance, but a blink always closes the lids.
            if value is not None:
                self._stored[name] = value if name.startswith("lid") else self._amount * value
            # The share moves linearly to 1 or 0; the smooth step has speed 0 at both ends.
            share = toward(self._shares[name], float(value is not None), CUE_PERIOD_S / fade_s)
            self._shares[name] = share
            if share > 0.0:
                live_value = getattr(live, name) or 0.0
                mixed[name] = live_value + smoothstep(share) * (self._stored[name] - live_value)
        return replace(live, **mixed) if mixed else live


#: A pause within a sentence: up to so long a silence counts as speaking.
_PAUSE_S: Final = 0.3
#: After so long a silence, head motion without a target counts as idle, no longer as expression.
_IDLE_AFTER_S: Final = 4.0


class ExpressionLayer:
    """The expression of a face: call `advance` once for every 10 ms shown, then `claims`."""

    def __init__(
        self,
        source: ExpressionSource | None,
        voice: HeardVoice,
        servos: Sequence[ExpressionServo],
        requests: ExpressionRequests,
        rest_after_s: float = math.inf,
    ) -> None:
        """Create the layer with the face at neutral.

        source: of live expression; None: affect only, in the mouth. voice: prosody of the sound.
        servos: those that show the expression; empty: only displays do. requests: the settings set
        last. rest_after_s: seconds of silence after which a face without source counts as resting.
        """
        self.voice = voice
        self._source = source
        self._rest_after_s = rest_after_s
        self._claims = ExpressionClaims(servos, CUE_PERIOD_S)
        #: Whether the face has servos for an expression; without them only displays show it.
        self.moves_servos = bool(servos)
        self.requests = requests
        self._performed = PerformedExpression()
        self._n_steps = 0
        self._silent_s = 0.0
        #: The arousal of the voice shown now plus the one that was set: -1 to 1.
        self.arousal = 0.0
        #: The valence that was set, as far as it has not faded: -1 to 1. No voice changes it.
        self.valence = 0.0
        self._is_speaking = False
        #: The expression that is shown now.
        self.expression: Expression = NO_EXPRESSION

    @property
    def is_resting(self) -> bool:
        """Whether the face stays at neutral after a long silence, so that torque may go off."""
        if self._source is None:
            return self._silent_s > self._rest_after_s
        return self._silent_s > _IDLE_AFTER_S and self._source.is_resting

    @property
    def mouth_gain(self) -> float:
        """The factor on the mouth's motion for the arousal, 0.85 to 1.2; closed lips excepted."""
        return max(0.85, 1.0 + 0.2 * self.arousal)

    def change(self, settings: Mapping[str, float]) -> None:
        """Apply changed settings, by the names of `expression_settings`; a change ends resting."""
        if self.requests.change(settings):
            self.wake()

    def wake(self) -> None:
        """End resting: set the count of silent seconds to 0, as before sound is played."""
        self._silent_s = 0.0

    def advance(
        self,
        sound_s: float,
        now_s: float,
        *,
        is_speaking: bool,
        performed: Expression = NO_EXPRESSION,
    ) -> None:
        """Compute the next 10 ms of expression, heard at `sound_s`, shown at monotonic `now_s`.

        is_speaking: the mouth says a phoneme at that instant. performed: the expression that a
        performance contains for it, which replaces the live one.
        """
        self._silent_s = 0.0 if is_speaking else self._silent_s + CUE_PERIOD_S
        self._is_speaking = self._silent_s < _PAUSE_S
        voice = self.voice.at(sound_s)
        self.valence, arousal = self.requests.affect_at(now_s)
        self.arousal = min(1.0, max(-1.0, voice.arousal + arousal))
        if self._source is None:
            return
        self._n_steps += 1
        amount = self.requests.amount
        live = self._source.step(
            ExpressionCue(
                time_s=self._n_steps * CUE_PERIOD_S,
                voice=voice,
                is_speaking=self._is_speaking,
                silent_s=self._silent_s,
                look_at_deg=self.requests.look_at_deg,
                valence=self.valence,
                arousal=self.arousal,
                amount=amount,
            )
        )
        self.expression = self._performed.step(live, performed, amount)

    def claims(self, mouth: Claim) -> list[Claim]:
        """Return the claims of lips and expression for the 10 ms of the last `advance`.

        mouth: the lips' claim; while the face does not speak, its corners may smile instead.
        """
        is_idle = self._silent_s > _IDLE_AFTER_S and self.requests.look_at_deg is None
        claims = self._claims.claims(self.expression, Layer.IDLE if is_idle else Layer.EXPRESSION)
        if self._is_speaking:
            return [*claims, mouth]
        return [*claims, *self._claims.mouth(self.expression, mouth)]


def expression_source(settings: ExpressionSettings, seed: int) -> ExpressionSource:
    """Return the source of a face's live expressions. seed: of random motion."""
    # Imported here: only faces that show an expression load it.
    from lipsync.expression.live_expression import LiveExpression

    shares = {} if settings.eye_contact is None else {"talking_mutual_share": settings.eye_contact}
    return LiveExpression(seed, rest_after_s=settings.rest_after_s, **shares)


def make_expression(face: FaceSettings, *, is_watched: bool) -> ExpressionLayer:
    """Return the expression layer of a face, with its voice tracker, source and servos.

    is_watched: a page may show a head with eyes, so a source is made even without expression
    servos.
    """
    servos, source = expression_servos(face), None
    if servos or is_watched:
        source = expression_source(face.expression, face.expression.seed)
    voice, requests = HeardVoice(VoiceTracker()), ExpressionRequests(face.expression.amount)
    return ExpressionLayer(source, voice, servos, requests, face.expression.rest_after_s)
