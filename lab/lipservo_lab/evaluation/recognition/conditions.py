"""What the bench does to speech before it is heard: noise, babble, another level or line."""

import zlib
from dataclasses import dataclass

import numpy as np

from lipservo_lab.evaluation.recognition.servo_noise import encoder_readings_deg, servo_noise
from lipservo_lab.evaluation.recognition.shoebox_room import in_room
from lipservo_lab.learning.recognition import noise
from lipsync.arrays import Array, Array32
from lipsync.errors import UserError

KINDS = ("white", "music", "babble", "servos", "level", "telephone", "clipped", "room")
#: Those that are made of the speech alone; the number after the colon is a level, or not needed.
_OPTIONAL_DB = ("telephone", "clipped", "room")


class ConditionError(UserError):
    """A condition that is not known; the message is one line."""


@dataclass(frozen=True, slots=True)
class Condition:
    """How speech is changed. db: signal to noise, or for `level` the change of level.

    robot: whose servos are heard. tells_servos: the recogniser is told how they move.
    """

    kind: str
    db: float
    robot: int = 0
    tells_servos: bool = False

    def apply(self, samples: Array32, name: str, voices: list[Array32]) -> Array32:
        """The samples (n,) as they are heard; the utterance's name chooses the random numbers.

        voices: other recordings, for babble.
        """
        rng = _rng(name)
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
        if self.kind == "servos":
            return noise.add_noise(samples, servo_noise(rng, len(samples), self.robot)[0], self.db)
        maker = {"white": noise.white, "music": noise.band, "babble": noise.babble(voices)}
        return noise.add_noise(samples, maker[self.kind](rng, len(samples)), self.db)

    def servo_positions_deg(self, name: str, n_samples: int) -> Array | None:
        """What the encoders say, a row (n_servos,) each 10 ms; None: nobody tells."""
        if not self.tells_servos:
            return None
        return encoder_readings_deg(servo_noise(_rng(name), n_samples, self.robot)[1])


def parse_condition(text: str, *, tells_servos: bool = False) -> Condition:
    """`KIND:DB`, as `white:10`, or `servos:DB:ROBOT`.

    tells_servos: as `Condition` has it. Raises ConditionError for another form, and for servos
    that are told of and not heard.
    """
    if tells_servos and not text.startswith("servos:"):
        raise ConditionError("--servo-speeds is for the noise of servos; give --noise servos:10")
    kind, _, db = text.partition(":")
    db, _, robot = db.partition(":") if kind == "servos" else (db, "", "")
    try:
        level_db = 0.0 if not db and kind in _OPTIONAL_DB else float(db)
        return Condition(_known(kind), level_db, _number(robot or "0"), tells_servos)
    except ValueError as error:
        raise ConditionError(
            f"--noise {text!r} is not KIND:DB; kinds: {', '.join(KINDS)}; for example white:10"
        ) from error


def _rng(name: str) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(name.encode()))


def _number(text: str) -> int:
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)


def _known(kind: str) -> str:
    if kind not in KINDS:
        raise ValueError(kind)
    return kind
