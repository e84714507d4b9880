"""Wei and Deng's method as printed: each component is clustered, selected and blended by itself.

Five principal components; an AnimPho (recorded piece of motion) is a cluster of all segments, with
the commonest phoneme in it; derivatives of eq. (5) in samples. docs/motion.md says what differs
from the paper nevertheless.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.evaluation.motion.methods import Heard
from lipservo_lab.learning.motion.face_training import clustered_alike, cut_segments
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.animpho.selection import STRATEGIES
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.animpho.units import AnimPhoUnits
from lipsync.arrays import Array
from lipsync.phonemes import PhonemeUpdate

AS_PRINTED: Final = "as-printed"
COMPONENTS: Final = 5


@dataclass(frozen=True, slots=True)
class PrintedMethod:
    """The paper's priority strategy, run by itself for each of the first five components.

    units: for each component its AnimPhos, with samples (m, 5, 1). Other components stay at rest.
    """

    units: tuple[AnimPhoUnits, ...]
    name: str = AS_PRINTED
    looks_ahead: bool = False

    @classmethod
    def of(cls, model: TrainedModel, corpus: Corpus, *, seed: int = 0) -> "PrintedMethod":
        """Return the method with AnimPhos of the sentences that the model was trained on.

        corpus: labelled, with these sentences. seed: of the clustering.
        """
        learned = corpus.keep(set(model.training_sentences)).utterances
        segments = cut_segments(learned, [model.coefficients(u.markers_mm) for u in learned])
        n = min(COMPONENTS, model.n_components)
        return cls(tuple(clustered_alike(segments, model.rest, c, seed) for c in range(n)))

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees phones whole
        """Return faces with every phone known when it begins; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        faces = np.tile(model.rest, (len(times_s), 1))
        for component, units in enumerate(self.units):
            synth = PublishedSynthesizer(units, STRATEGIES["priority"], published_derivatives=True)
            synth.push(PhonemeUpdate(0.0, np.inf, np.inf, heard.events))
            faces[:, component] = [synth.frame_at(float(t)).coefficients[0] for t in times_s]
        return faces
