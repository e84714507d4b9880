"""The live method: the learned expectation, with strength, rest and closures around it."""

from dataclasses import dataclass, replace

from lipsync.errors import UserError
from lipsync.expectation.expectation import Expectation
from lipsync.face.model import FaceModel
from lipsync.motion.closing_synthesizer import ClosingSynthesizer
from lipsync.motion.closure_plan import BILABIALS, LABIODENTALS
from lipsync.motion.expected_motion import ExpectedMotion
from lipsync.motion.lip_closure import lip_gap_of
from lipsync.motion.resting_synthesizer import RestingSynthesizer
from lipsync.motion.scaled_synthesizer import ScaledSynthesizer
from lipsync.motion.wrapped_synthesizer import WrappedSynthesizer
from lipsync.phonemes import PHONEMES

#: Its name on the command line and in results.
LIVE_STRATEGY = "expected"
DEFAULT_LOOKAHEAD_S = 0.1
LONGEST_LOOKAHEAD_S = 1.0
STRONGEST = 1.5
_CLOSING = (*BILABIALS, *LABIODENTALS)


class StyleError(UserError):
    """A strength, smoothness or look-ahead outside what is allowed."""


@dataclass(frozen=True, slots=True)
class Style:
    """What the user may set.

    lookahead_s: how much later than its sound a face may be shown, for the sake of what comes next;
    strength: 0 keeps the mouth closed, 1 moves as the speaker did, 1.5 is as far as it goes;
    smoothness: 0 follows at once, 1 is as slow as it gets.
    """

    lookahead_s: float = DEFAULT_LOOKAHEAD_S
    strength: float = 1.0
    smoothness: float = 0.0

    def __post_init__(self) -> None:
        limits = {
            "lookahead_s": LONGEST_LOOKAHEAD_S,
            "strength": STRONGEST,
            "smoothness": 1.0,
        }
        for name, most in limits.items():
            value = getattr(self, name)
            if not 0.0 <= value <= most:
                raise StyleError(f"{name} is {value}; allowed: 0 to {most}")


class LiveSynthesizer(WrappedSynthesizer):
    """Our strategy over a revisable stream of phonemes."""

    def __init__(
        self, model: FaceModel, expectation: Expectation, style: Style | None = None
    ) -> None:
        self._style = style or Style()
        self._expected = ExpectedMotion(
            expectation,
            model.rest,
            lookahead_s=self._style.lookahead_s,
            smoothness=self._style.smoothness,
        )
        known_s = self._expected.known_s
        self._scaled = ScaledSynthesizer(
            self._expected, model.rest, self._style.strength, strongest=STRONGEST
        )
        self._resting = RestingSynthesizer(self._scaled, model.rest, known_s)
        closing = ClosingSynthesizer(
            self._resting,
            lip_gap_of(model),
            labiodental_gap_mm=model.labiodental_gap_mm,
            tightest_s={p: float(model.tightest_s[PHONEMES.index(p)]) for p in _CLOSING},
            known_s=known_s,
        )
        super().__init__(closing)

    @property
    def is_resting(self) -> bool:
        """Whether the mouth is at rest, or on its way there, because nobody speaks."""
        return self._resting.is_resting

    def adjust(self, name: str, value: float) -> None:
        """Set `strength` or `smoothness` from the newest face on, eased in over `ADJUSTING_S`.

        What was shown stays as it was. Raises StyleError for another name, or beyond its limits.
        """
        if name not in ("strength", "smoothness"):
            raise StyleError(f"{name} cannot be adjusted; strength and smoothness can")
        self._style = replace(self._style, **{name: value})
        if name == "strength":
            self._scaled.adjust_strength(value)
        else:
            self._expected.adjust_smoothness(value)
