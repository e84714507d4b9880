"""How much later than its sound a face is shown, part by part."""

from dataclasses import dataclass, replace

from lipsync.audio_block import BLOCK_S

#: The speech side publishes at 100 Hz (architecture.md, Time).
PUBLISH_PERIOD_S = 0.010


@dataclass(frozen=True, slots=True)
class Delay:
    """How much later than its sound a face is shown, part by part. Added up here and only here."""

    recognizer_s: float
    lookahead_s: float
    sound_block_s: float = BLOCK_S
    publish_period_s: float = PUBLISH_PERIOD_S
    actuation_s: float = 0.0
    loudspeaker_s: float = 0.0

    @property
    def synthesis_s(self) -> float:
        """How much sound must have been heard after an instant before its face is computed."""
        return self.recognizer_s + self.lookahead_s + self.sound_block_s + self.loudspeaker_s

    def at_least(self, delay_s: float) -> "Delay":
        """The same, with the face waiting for a loudspeaker that is later than all else."""
        return replace(self, loudspeaker_s=max(0.0, delay_s - self.total_s))

    @property
    def total_s(self) -> float:
        """Display time minus sound time."""
        return self.synthesis_s + self.publish_period_s + self.actuation_s

    def __str__(self) -> str:
        parts = {
            "recogniser": self.recognizer_s,
            "look-ahead": self.lookahead_s,
            "sound block": self.sound_block_s,
            "publishing": self.publish_period_s,
            "actuation": self.actuation_s,
            "loudspeaker": self.loudspeaker_s,
        }
        listed = " + ".join(f"{name} {s * 1e3:.0f}" for name, s in parts.items() if s)
        return f"{self.total_s * 1e3:.0f} ms = {listed}"
