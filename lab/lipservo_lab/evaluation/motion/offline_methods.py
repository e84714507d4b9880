"""Methods for whole lines, which know all of the sound, among the methods that are compared.

They are trained on the same sentences as the face model that is scored. Those of `render` need the
sound of each sentence too.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from lipservo_lab.baselines.baselines import joined_faces
from lipservo_lab.baselines.context_visemes import ContextVisemes
from lipservo_lab.evaluation.motion.methods import CATMULL_ROM, Heard
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.audio.file import read_speech
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.offline.line_methods import (
    Line,
    LineMethod,
    Speaker,
    line_synthesizer,
    model_based_line,
    shown_faces,
)
from lipsync.offline.line_synthesis import joined_phones
from lipsync.offline.offline_model import OfflineModel
from lipsync.recognition.network import load_shipped_weights
from lipsync.recognition.posteriors import whole_posteriors

_Key = tuple[str, tuple[str, ...]]
_Made = TypeVar("_Made")


@dataclass(slots=True)
class OncePerModel(Generic[_Made]):
    """What is made of the sentences that trained a face model, once for each face model.

    make: makes it at the first use.
    """

    make: Callable[[TrainedModel], _Made]
    _made: dict[_Key, _Made] = field(default_factory=dict)

    def of(self, model: TrainedModel) -> _Made:
        """Return what belongs to a face model; made at the first call."""
        # Models may have equal checksums and other training sentences.
        key = model.checksum, tuple(model.training_sentences)
        if key not in self._made:
            self._made[key] = self.make(model)
        return self._made[key]


#: Offline models, and recorded phones with their faces.
OfflineModels = OncePerModel[OfflineModel]
RecordedVisemes = OncePerModel[ContextVisemes]


@dataclass(frozen=True, slots=True)
class ContextVisemeMethod:
    """Catmull-Rom through context visemes: Edge, Hilton and Jackson compare theirs with it."""

    visemes: RecordedVisemes
    name: str = CATMULL_ROM
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees all
        """Return faces from the whole sentence; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        targets = self.visemes.of(model).targets(heard.events)
        return joined_faces(heard.events, targets, times_s)


@dataclass(frozen=True, slots=True)
class OfflineMethod:
    """A method for whole lines with a state model.

    name: `model-based`, Edge, Hilton and Jackson's exactly, without closures and rest; or `heard`,
    ours, as in `render`.
    """

    name: LineMethod
    models: OfflineModels
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - hears all
        """Return the faces that a method for whole lines makes of a sentence.

        Faces of `model-based` are interpolated linearly between its frames. Raises ValueError for a
        sentence without sound.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        if heard.sound_path is None:
            raise ValueError(f"{self.name} needs the sound of a sentence")
        offline = self.models.of(model)
        rate_hz = offline.states.frame_rate_hz
        samples = read_speech(heard.sound_path)
        # The method gets the line to its end, even if the last frames are not wanted.
        duration_s = max(float(times_s[-1]) + 1.0 / rate_hz, len(samples) / SAMPLE_RATE_HZ)
        # Labels have no updates and need no posteriors: they are certain.
        posteriors = whole_posteriors(load_shipped_weights(), samples) if heard.updates else None
        line = Line(joined_phones(heard.events, duration_s), samples, posteriors)
        speaker = Speaker(model, model.expectation, offline, model.soft)
        if self.name == "model-based":
            n_frames = int(np.ceil(duration_s * rate_hz - 1e-6))
            made = model_based_line(speaker, line, n_frames).faces
            frames_s = np.arange(n_frames) / rate_hz
            return np.stack([np.interp(times_s, frames_s, each) for each in made.T], axis=1)
        return shown_faces(line_synthesizer(speaker, line, self.name)[0], times_s)
