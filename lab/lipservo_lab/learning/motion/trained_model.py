"""A trained model of one speaker's face with everything that moves it, and its file.

A program that plays a face loads only the parts that it needs; evaluation loads all of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lipservo_lab.baselines.baselines import (
    BASELINES_PART,
    Baselines,
    baseline_arrays,
    read_baselines,
)
from lipsync.animpho.units import (
    ANIMPHO_PART,
    FaceWithAnimPhos,
    animpho_arrays,
    face_fields,
    read_animphos,
)
from lipsync.expectation.expectation import (
    EXPECTATION_PART,
    Expectation,
    expectation_arrays,
    read_expectation,
)
from lipsync.expectation.soft_expectation import (
    SOFT_PART,
    SoftExpectation,
    read_soft_expectation,
    soft_arrays,
)
from lipsync.face.model import FACE_PART, face_arrays, open_model, read_face, write_model


@dataclass(frozen=True, slots=True)
class TrainedModel(FaceWithAnimPhos):
    """A face and all that can move it, with the names of the sentences it was learned from.

    expectation: predicts the mean motion of decided phonemes. soft: the same from a recogniser's
    phoneme posteriors; None if it was learned without. provenance: corpus, seed, and how much was
    learned from, by name.
    """

    expectation: Expectation
    baselines: Baselines
    training_sentences: tuple[str, ...]
    provenance: Mapping[str, str | int | float]
    soft: SoftExpectation | None = None


def load_trained_model(path: Path | None = None) -> TrainedModel:
    """Read all parts of a model file; path None: the shipped file.

    Raises ModelError for a file that cannot be read or lacks a part (`soft` may be missing).
    """
    with open_model(path) as file:
        face = read_face(file)
        return TrainedModel(
            **face_fields(face),
            animphos=read_animphos(file, face),
            expectation=read_expectation(file, face.n_components),
            soft=read_soft_expectation(file, face.n_components),
            baselines=read_baselines(file, face.n_components),
            training_sentences=tuple(file.about["training_sentences"]),
            provenance=dict(file.about["provenance"]),
        )


def save_model(model: TrainedModel, path: Path) -> None:
    """Write the model whole or not at all. Raises OutputError."""
    about = {
        "training_sentences": model.training_sentences,
        "provenance": dict(model.provenance),
    }
    parts = {
        FACE_PART: face_arrays(model),
        EXPECTATION_PART: expectation_arrays(model.expectation),
        ANIMPHO_PART: animpho_arrays(model.animphos),
        BASELINES_PART: baseline_arrays(model.baselines),
    }
    if model.soft is not None:
        parts[SOFT_PART] = soft_arrays(model.soft)
    write_model(path, model.layout, about, parts)
