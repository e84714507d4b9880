"""All that lines are rendered with: states and units, the expectation of sound, the voice."""

from collections.abc import Mapping
from dataclasses import dataclass

from lipsync.errors import UserError
from lipsync.face.model import FaceModel
from lipsync.offline.sound_expectation import SoundExpectation
from lipsync.offline.state_model import StateModel
from lipsync.offline.voice_likeness import VoiceLikeness


class OfflineModelError(UserError):
    """An offline model that cannot be used: says which, why, and what to do."""


@dataclass(frozen=True, slots=True)
class OfflineModel:
    """Made of one corpus, for one face model.

    face_checksum: of that face. training_sentences: by name. provenance: corpus, seed, how much.
    """

    face_checksum: str
    states: StateModel
    sound: SoundExpectation
    voice: VoiceLikeness
    training_sentences: tuple[str, ...]
    provenance: Mapping[str, str | int | float]

    def check_face(self, face: FaceModel, name: str) -> None:
        """Raises OfflineModelError for a face that this model was not made for."""
        if face.checksum != self.face_checksum:
            raise OfflineModelError(
                f"{name}: made for face model {self.face_checksum}, this face is {face.checksum}; "
                "make one with `lipservo learn offline CORPUS --model FACE -o FILE`"
            )
