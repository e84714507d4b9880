"""The live methods: whatever moves the mouth, with strength, rest and closures around it."""

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass

from lipsync.animpho.units import AnimPhoUnits
from lipsync.errors import UserError
from lipsync.expectation.expectation import Expectation
from lipsync.face.model import FaceModel
from lipsync.motion.closing_synthesizer import ClosingSynthesizer
from lipsync.motion.closure_plan import BILABIALS, LABIODENTALS
from lipsync.motion.expected_motion import USED_LOOKAHEAD_S, ExpectedMotion
from lipsync.motion.lip_closure import lip_gap_of
from lipsync.motion.mixing_synthesizer import MixingSynthesizer
from lipsync.motion.resting_synthesizer import RestingSynthesizer
from lipsync.motion.scaled_synthesizer import ScaledSynthesizer
from lipsync.motion.unit_motion import UnitMotion
from lipsync.motion.wrapped_synthesizer import TrackedSynthesizer, WrappedSynthesizer
from lipsync.phonemes import PHONEMES

#: Their names on the command line and in results: the expectation, and AnimPhos near it.
LIVE_STRATEGY = "expected"
UNIT_STRATEGY = "animpho"
DEFAULT_LOOKAHEAD_S = 0.1
LONGEST_LOOKAHEAD_S = 1.0
STRONGEST = 1.5
#: Chosen on inner splits (decisions/0028).
DEFAULT_UNIT_SHARE = 0.25
_CLOSING = (*BILABIALS, *LABIODENTALS)


class StyleError(UserError):
    """A strength, smoothness or look-ahead outside what is allowed."""


@dataclass(frozen=True, slots=True)
class Style:
    """What the user may set.

    lookahead_s: how much later than its sound a face may be shown, for the sake of what comes next;
    strength: 0 keeps the mouth closed, 1 moves as the speaker did, 1.5 is as far as it goes;
    smoothness: 0 follows at once, 1 is as slow as it gets. unit_share: of AnimPhos in the motion,
    where a synthesiser has any: 0 plays the expectation, 1 AnimPhos alone.
    """

    lookahead_s: float = DEFAULT_LOOKAHEAD_S
    strength: float = 1.0
    smoothness: float = 0.0
    unit_share: float = DEFAULT_UNIT_SHARE

    def __post_init__(self) -> None:
        limits = {
            "lookahead_s": LONGEST_LOOKAHEAD_S,
            "strength": STRONGEST,
            "smoothness": 1.0,
            "unit_share": 1.0,
        }
        for name, most in limits.items():
            value = getattr(self, name)
            if not 0.0 <= value <= most:
                raise StyleError(f"{name} is {value}; allowed: 0 to {most}")


class FinishedSynthesizer(WrappedSynthesizer):
    """What every method has around it live: strength, rest in pauses, closures of the lips."""

    def __init__(
        self,
        model: FaceModel,
        inner: TrackedSynthesizer,
        strength: float = 1.0,
        adjust_inner: Mapping[str, Callable[[float], None]] | None = None,
    ) -> None:
        """adjust_inner: how what is inside takes a new value of its own settings, by name."""
        known_s = min(inner.lookahead_s, USED_LOOKAHEAD_S)
        self._strength = strength
        scaled = ScaledSynthesizer(inner, model.rest, strength, strongest=STRONGEST)
        self._resting = RestingSynthesizer(scaled, model.rest, known_s)
        closing = ClosingSynthesizer(
            self._resting,
            lip_gap_of(model),
            labiodental_gap_mm=model.labiodental_gap_mm,
            tightest_s={p: float(model.tightest_s[PHONEMES.index(p)]) for p in _CLOSING},
            known_s=known_s,
        )
        super().__init__(closing)
        self._adjust = {**(adjust_inner or {}), "strength": scaled.adjust_strength}

    @property
    def is_resting(self) -> bool:
        """Whether the mouth is at rest, or on its way there, because nobody speaks."""
        return self._resting.is_resting

    @property
    def strength(self) -> float:
        """As it was set last."""
        return self._strength

    @property
    def adjustable(self) -> Set[str]:
        """Names of the settings that may change while the mouth moves."""
        return self._adjust.keys()

    def adjust(self, name: str, value: float) -> None:
        """Set a setting from the newest face on, eased in over `ADJUSTING_S`.

        What was shown stays as it was. Raises StyleError for a setting that it has not, or beyond
        its limits.
        """
        if name not in self._adjust:
            raise StyleError(f"{name} cannot be adjusted; {', '.join(sorted(self._adjust))} can")
        Style(**{name: value})
        if name == "strength":
            self._strength = value
        self._adjust[name](value)


class LiveSynthesizer(FinishedSynthesizer):
    """Our strategies over a revisable stream of phonemes."""

    def __init__(
        self,
        model: FaceModel,
        expectation: Expectation,
        style: Style | None = None,
        units: AnimPhoUnits | None = None,
    ) -> None:
        """units: AnimPhos to choose from; None: the expectation alone, whatever `unit_share` is."""
        style = style or Style()
        inner: TrackedSynthesizer
        inner = expected = ExpectedMotion(
            expectation, model.rest, lookahead_s=style.lookahead_s, smoothness=style.smoothness
        )
        adjust: dict[str, Callable[[float], None]] = {"smoothness": expected.adjust_smoothness}
        if units is not None:
            motion = UnitMotion(units, expectation, expected.known_s)
            inner = mixing = MixingSynthesizer(expected, motion, style.unit_share)
            adjust["unit_share"] = mixing.adjust_unit_share
        super().__init__(model, inner, style.strength, adjust)
