"""What a face's expression is made from, one cue every 10 ms; and who makes it."""

from dataclasses import dataclass
from typing import Final, Protocol

from lipsync.face.frame import Expression
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame

#: From one cue to the next.
CUE_PERIOD_S: Final = 0.010


@dataclass(frozen=True, slots=True)
class ExpressionCue:
    """One moment of sound time, causal.

    time_s: sound time; it grows by CUE_PERIOD_S. voice: what was heard. is_speaking: the robot's
    mouth speaks (pauses within a sentence count as speech until 0.3 s have passed). silent_s: how
    long nobody has spoken. look_at_deg: (yaw, pitch) of somebody to look at, in the robot's own
    frame, None: nobody. valence: -1 (sad) to 1 (glad), as a dialogue system says; arousal: -1 to 1,
    of the voice or as a dialogue system says. amount: 0 (still) to 1 (as measured on people), and
    up to 1.5.
    """

    time_s: float
    voice: VoiceFrame = SILENT_VOICE
    is_speaking: bool = False
    silent_s: float = 0.0
    look_at_deg: tuple[float, float] | None = None
    valence: float = 0.0
    arousal: float = 0.0
    amount: float = 1.0


class ExpressionSource(Protocol):
    """Whoever makes expressions. State and a seeded generator only: same cues, same motion."""

    def step(self, cue: ExpressionCue) -> Expression:
        """The expression of the cue's moment; call it once for each, in order."""


class WholeExpression(ExpressionSource, Protocol):
    """One that knows when there is nothing to show."""

    @property
    def is_resting(self) -> bool:
        """Whether it is at neutral, and stays there until somebody speaks or moves."""
