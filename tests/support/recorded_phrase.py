"""The small model's own motion of one phrase: an utterance that can be scored."""

from pathlib import Path

import numpy as np
from lipservo_lab.baselines.baselines import spline_faces
from lipservo_lab.corpus.utterance import Utterance
from small_model import small_model
from spoken_phonemes import spoken

PHRASE = spoken(("SIL", 0.4), ("M", 0.12), ("AA", 0.2), ("UW", 0.2), ("M", 0.12), ("SIL", 0.4))


def recorded(events=PHRASE, name="u", rate_hz=25.0, words=()) -> Utterance:
    """With a little noise."""
    model = small_model()
    times_s = np.arange(round(events[-1].end_s * rate_hz)) / rate_hz
    faces = spline_faces(events, model.baselines.centres, times_s)
    faces = faces + np.random.default_rng(0).normal(0.0, 0.3, faces.shape)
    return Utterance(name, model.markers_mm(faces), rate_hz, Path(), events, words)
