"""What became of a clip, in figures and in words."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True, slots=True)
class ClipReport:
    """One clip, or one part of a long one.

    left_out: why a corpus has nothing of it; None where it has. notes: what was put right or is
    doubtful. phonemes: `text` or `recognised`. text_score: as `lipservo lines align` has it.
    shift_ms: how much later than the picture the sound was found; corrected_ms: by how much it was
    put right. gap_r: correlation of the lip gap that is seen with the one that the shipped model
    expects of the sound, after the correction. Angles: the head's, medians over the pictures.
    """

    clip: str
    left_out: str | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    phonemes: str | None = None
    text_score: float | None = None
    shift_ms: int | None = None
    corrected_ms: int | None = None
    gap_r: float | None = None
    eye_distance_px: float | None = None
    yaw_deg: float | None = None
    pitch_deg: float | None = None

    def as_json(self) -> dict[str, object]:
        """By name."""
        return asdict(self)
