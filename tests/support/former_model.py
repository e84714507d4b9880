"""Writes model files as earlier versions did."""

import io
import json
from pathlib import Path

import numpy as np
from lipservo_lab.learning.motion.trained_model import TrainedModel

from lipsync.phonemes import PHONEMES


def write_former_model(model: TrainedModel, path: Path, version: int = 3) -> None:
    """Version 3: all arrays side by side, the points told by their names."""
    about = {
        "version": version,
        "marker_names": model.layout.names,
        "phonemes": PHONEMES,
        "training_sentences": model.training_sentences,
        "provenance": dict(model.provenance),
    }
    units, baselines = model.animphos, model.baselines
    arrays = {
        "about": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
        "mean_mm": model.mean_mm.astype(np.float32),
        "basis": model.basis.astype(np.float32),
        "head_reference_mm": model.head_reference_mm.astype(np.float32),
        "rest": model.rest.astype(np.float32),
        "animphos": units.samples.astype(np.float32),
        "successor_starts": units.successors.starts.astype(np.int32),
        "successors": units.successors.indices.astype(np.int32),
        "phoneme_starts": units.phoneme_table.starts.astype(np.int32),
        "phoneme_animphos": units.phoneme_table.indices.astype(np.int32),
        "covariance": model.covariance.astype(np.float32),
        "labiodental_gap_mm": np.array(model.labiodental_gap_mm, dtype=np.float32),
        "tightest_s": model.tightest_s.astype(np.float32),
        "centres": baselines.centres.astype(np.float32),
        "counts": baselines.counts.astype(np.float32),
        "dominance": np.stack([baselines.dominance.rates_per_s, baselines.dominance.powers]),
        "regression": baselines.regression.weights.astype(np.float32),
    }
    for name, values in model.expectation.arrays().items():
        arrays[f"expectation_{name}"] = values.astype(np.float32)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    path.write_bytes(buffer.getvalue())
