"""What the bench does to speech before it is heard: noise, babble, another level or line."""

import zlib
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array32
from lipsync.errors import UserError
from lipsync.evaluation.recognition.shoebox_room import in_room
from lipsync.recognition.training import noise

KINDS = ("white", "music", "babble", "level", "telephone", "clipped", "room")
#: Those that are made of the speech alone; the number after the colon is a level, or not needed.
_OPTIONAL_DB = ("telephone", "clipped", "room")


class ConditionError(UserError):
    """A condition that is not known; the message is one line."""


@dataclass(frozen=True, slots=True)
class Condition:
    """How speech is changed. db: signal to noise, or for `level` the change of level."""

    kind: str
    db: float

    def apply(self, samples: Array32, name: str, voices: list[Array32]) -> Array32:
        """The samples (n,) as they are heard; the utterance's name chooses the random numbers.

        voices: other recordings, for babble.
        """
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        if self.kind == "level":
            return samples * np.float32(10.0 ** (self.db / 20.0))
        if self.kind == "telephone":
            return noise.telephone(samples)
        if self.kind == "room":
            return in_room(rng, samples)
        if self.kind == "clipped":
            # Ten times over full scale (design measurement).
            gain = np.float32(10.0 / max(np.abs(samples).max(), 1e-9))
            clipped: Array32 = np.clip(samples * gain, -1.0, 1.0)
            return clipped
        maker = {"white": noise.white, "music": noise.band, "babble": noise.babble(voices)}
        return noise.add_noise(samples, maker[self.kind](rng, len(samples)), self.db)


def parse_condition(text: str) -> Condition:
    """`KIND:DB`, as `white:10`; ConditionError for another form."""
    kind, _, db = text.partition(":")
    try:
        return Condition(_known(kind), 0.0 if not db and kind in _OPTIONAL_DB else float(db))
    except ValueError as error:
        raise ConditionError(
            f"--noise {text!r} is not KIND:DB; kinds: {', '.join(KINDS)}; for example white:10"
        ) from error


def _known(kind: str) -> str:
    if kind not in KINDS:
        raise ValueError(kind)
    return kind
