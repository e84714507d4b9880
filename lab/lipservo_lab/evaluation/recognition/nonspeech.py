"""What the mouth does while nobody speaks: how long, how often and how wide it opens for sounds."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lipservo_lab.evaluation.recognition.heard_motion import heard_motion
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import LiveRecognizer

#: Lips this much further apart than at rest are open, mm.
OPEN_MM = 2.0


@dataclass(frozen=True, slots=True)
class MouthDuringSound:
    """A sound that holds no speech, and what the mouth made of it.

    open_s: with open lips; speech_s: heard as speech; widest_mm: lip gap beyond the one at rest.
    """

    seconds: float
    open_s: float
    speech_s: float
    n_openings: int
    widest_mm: float


def mouth_during(
    sound: Path, recognizer: LiveRecognizer, model: TrainedModel, lookahead_s: float
) -> MouthDuringSound:
    """Play a sound to a recogniser, which is reset, and the live method by what it says.

    Open lips and speech count until the sound ends; openings and the widest also in the half second
    of silence after it. Raises SoundError for a file that is no sound.
    """
    motion = heard_motion(sound, recognizer, model, lookahead_s)
    gaps_mm = model.lip_gaps_mm(model.markers_mm(motion.faces))
    rest_mm = float(model.lip_gaps_mm(model.markers_mm(model.rest[None]))[0])
    is_open = gaps_mm > rest_mm + OPEN_MM
    within = motion.times_s < motion.sound_s
    return MouthDuringSound(
        seconds=motion.sound_s,
        open_s=TICK_S * int(is_open[within].sum()),
        speech_s=min(motion.spoken_s, motion.sound_s),
        n_openings=int(np.count_nonzero(np.diff(is_open.astype(np.int8), prepend=0) == 1)),
        widest_mm=float(gaps_mm.max() - rest_mm),
    )


def nonspeech_figures(mouths: Iterable[MouthDuringSound]) -> dict[str, float]:
    """Shares of the time of all sounds together, openings a minute of it, the widest of all."""
    found = list(mouths)
    seconds = sum(mouth.seconds for mouth in found)
    return {
        "open_share": sum(mouth.open_s for mouth in found) / seconds,
        "speech_share": sum(mouth.speech_s for mouth in found) / seconds,
        "openings_per_min": 60.0 * sum(mouth.n_openings for mouth in found) / seconds,
        "widest_mm": max(mouth.widest_mm for mouth in found),
        "files": len(found),
        "seconds": seconds,
    }
