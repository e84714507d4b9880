"""Offline model files: one `.npz` without pickle, versioned, written whole or not at all."""

import io
import json
from collections.abc import Mapping
from dataclasses import fields
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lipsync.array_archive import UNREADABLE, ArrayArchive, about_in
from lipsync.offline.offline_model import (
    OfflineModel,
    OfflineModelError,
    SoundExpectation,
    StateModel,
    Units,
    VoiceLikeness,
)
from lipsync.output_file import write_whole
from lipsync.phonemes import PHONEMES

#: Raised whenever the meaning of a stored field changes.
OFFLINE_VERSION = 1
SHIPPED = "grid_s1_offline"
#: Every frame that was learned from is in it: a hundred times the shipped one, unpacked.
_MOST_BYTES = 500_000_000
_KIND = "lipservo offline model"
_ABOUT = "about"
#: The fields of a state model that are stored as they are; units and frame rate have other names.
_STATES = tuple(f.name for f in fields(StateModel) if f.name not in ("units", "frame_rate_hz"))
#: The types in which these fields are stored; all other numbers are stored as float32.
_AS: Mapping[str, type] = {"cepstra": np.float16, "states": np.int16, "borders": np.int32}
_UNITS = tuple(f.name for f in fields(Units))


def save_offline_model(model: OfflineModel, path: Path) -> None:
    """Write an offline model to a file, whole or not at all. Raises OutputError."""
    about = {
        "kind": _KIND,
        "version": OFFLINE_VERSION,
        "face": model.face_checksum,
        "phonemes": PHONEMES,
        "frame_rate_hz": model.states.frame_rate_hz,
        "voice_limit": model.voice.limit,
        "training_sentences": model.training_sentences,
        "provenance": dict(model.provenance),
    }
    arrays: dict[str, NDArray[Any]] = {
        _ABOUT: np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
        **{f"states/{n}": _narrow(n, getattr(model.states, n)) for n in _STATES},
        **{f"units/{n}": np.asarray(getattr(model.states.units, n), np.int32) for n in _UNITS},
        "sound/articulation": model.sound.articulation,
        "sound/mean": model.sound.mean,
        "sound/spread": model.sound.spread,
        **{f"sound/layer{i}": layer for i, layer in enumerate(model.sound.layers)},
        "voice/mean": model.voice.mean,
        "voice/precision": model.voice.precision,
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_whole(path, buffer.getvalue())


def _narrow(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return an array in the smaller type in which a file stores the field `name`."""
    return values if values.dtype == np.bool_ else values.astype(_AS.get(name, np.float32))


def is_offline_model(head: bytes) -> bool:
    """Return whether a file's first bytes `head` are those of an offline model."""
    return _KIND.encode() in about_in(head)


def load_offline_model(path: Path | None = None) -> OfflineModel:
    """Return the offline model in the file `path`; None: the shipped one.

    Raises OfflineModelError if the file is missing, damaged or of another version.
    """
    name = f"shipped model {SHIPPED}" if path is None else str(path)
    place = resources.files("lipsync.models") / f"{SHIPPED}.npz" if path is None else path
    try:
        file = place.open("rb")
    except FileNotFoundError:
        remedy = "reinstall lipservo" if path is None else "make one with `lipservo learn offline`"
        raise OfflineModelError(f"{name}: no such file; {remedy}") from None
    except OSError as error:
        raise OfflineModelError(f"{name}: cannot be read: {error.strerror}") from error
    try:
        with file, ArrayArchive(file, _MOST_BYTES) as archive:
            about = json.loads(archive[_ABOUT].tobytes())
            if not isinstance(about, dict) or about.get("kind") != _KIND:
                raise OfflineModelError(
                    f"{name}: not an offline model; make one with `lipservo learn offline`"
                )
            if about["version"] != OFFLINE_VERSION:
                raise OfflineModelError(
                    f"{name}: offline model version {about['version']}, this lipservo reads "
                    f"version {OFFLINE_VERSION}; make it again with `lipservo learn offline`"
                )
            model = _assembled_model({key: archive[key] for key in archive.names}, about)
        _check_model(model)
        return model
    except OfflineModelError:
        raise
    except (KeyError, TypeError, IndexError, AttributeError, *UNREADABLE) as error:
        raise OfflineModelError(
            f"{name}: damaged or not an offline model; get a fresh copy or make it again ({error})"
        ) from error


def _assembled_model(arrays: Mapping[str, NDArray[Any]], about: Mapping[str, Any]) -> OfflineModel:
    """Build the model from a file's arrays and its description `about`; shapes are not checked.

    Raises ValueError for a model of other phonemes, KeyError for a missing array.
    """
    if about["phonemes"] != list(PHONEMES):
        raise ValueError("the model's phonemes are not those of this lipservo version")
    wide: dict[str, Any] = {n: _wide(arrays[f"states/{n}"]) for n in _STATES}
    wide["cepstra"] = arrays["states/cepstra"].astype(np.float32)
    units = Units(**{n: arrays[f"units/{n}"].astype(np.int64) for n in _UNITS})
    n_layers = sum(key.startswith("sound/layer") for key in arrays)
    return OfflineModel(
        face_checksum=str(about["face"]),
        states=StateModel(frame_rate_hz=float(about["frame_rate_hz"]), units=units, **wide),
        sound=SoundExpectation(
            arrays["sound/articulation"],
            arrays["sound/mean"],
            arrays["sound/spread"],
            tuple(arrays[f"sound/layer{i}"] for i in range(n_layers)),
        ),
        voice=VoiceLikeness(
            arrays["voice/mean"],
            arrays["voice/precision"],
            float(about["voice_limit"]),
        ),
        training_sentences=tuple(about["training_sentences"]),
        provenance=dict(about["provenance"]),
    )


def _wide(values: NDArray[Any]) -> NDArray[Any]:
    """Return a file's array in the type for computing: int64, float64 or bool."""
    if values.dtype == np.bool_:
        return values
    return values.astype(np.int64 if values.dtype.kind in "iu" else np.float64)


def _check_model(model: OfflineModel) -> None:
    """Raise ValueError, naming the wrong field, unless shapes fit and values are in range."""
    states, sound = model.states, model.sound
    # n states, p components.
    n, p, n_frames = states.n_states, states.n_components, len(states.states)
    # The widths between the sound networks' layers: each layer takes what the one before returns.
    widths = [sound.mean.shape[0], *(layer.shape[-1] for layer in sound.layers[::2])]
    shapes = {
        "states/cepstra": (states.cepstra.shape[:1], (n_frames,)),
        "states/follows": (states.follows.shape, (n, n)),
        "states/means": (states.means.shape, (n, 2 * p)),
        "states/covariances": (states.covariances.shape, (n, 2 * p, 2 * p)),
        "states/basis": (states.basis.shape, (p, len(states.mean_mm))),
        "units/first": (states.units.first.shape, states.units.phonemes.shape),
        "units/end": (states.units.end.shape, states.units.phonemes.shape),
        "sound/spread": (sound.spread.shape, sound.mean.shape),
        # (m,) doubled is (m, m).
        "voice/precision": (model.voice.precision.shape, 2 * model.voice.mean.shape),
        "sound/layers": (tuple(layer.shape[1] for layer in sound.layers[::2]), tuple(widths[:-1])),
    }
    for field, (shape, expected) in shapes.items():
        if shape != expected:
            raise ValueError(f"array {field} has shape {shape}, expected {expected}")
    if states.borders[0] != 0 or states.borders[-1] != n_frames:
        raise ValueError("array states/borders does not cover all frames")
    if not ((states.states >= 0) & (states.states < n)).all():
        raise ValueError("array states/states names a state that does not exist")
    for field in ("cepstra", "means", "covariances", "mean_mm", "basis"):
        if not np.isfinite(getattr(states, field)).all():
            raise ValueError(f"array states/{field} has values that are not finite")
    if not all(np.isfinite(layer).all() for layer in (sound.mean, sound.spread, *sound.layers)):
        raise ValueError("array sound has values that are not finite")
