"""A folder of tracks becomes a model and its figures on what was held out."""

import json
from collections.abc import Sequence
from pathlib import Path

from lipservo_lab.learning.expression.expression_fit import fit_expression
from lipservo_lab.learning.expression.grid_tracks import read_grid_tracks
from lipservo_lab.learning.expression.held_out import measure_held_out
from lipservo_lab.learning.expression.track_files import read_track_files
from lipservo_lab.learning.expression.tracks import (
    ExpressionTrack,
    Progress,
    TrackError,
    check_alike,
    hear,
    nobody_watches,
)
from lipservo_lab.learning.learned_expression.expression_model import RATE_HZ, ExpressionModel

#: Without a list of its own a folder keeps every tenth recording for measuring.
_HELD_OUT_EVERY = 10


def train_expression(
    folder: Path, seed: int = 0, progress: Progress = nobody_watches
) -> tuple[ExpressionModel, dict[str, object]]:
    """The model, and its figures by name.

    folder: laid out like grid_s1 (it holds landmarks.json), or of CSV files beside sounds. Held out
    are the recordings that `random_test` of its splits.json names, else every tenth. Raises
    TrackError, CorpusError, SoundError.
    """
    tracks = read_tracks(folder, progress)
    check_alike(tracks)
    names = _held_out_names(folder, tracks)
    heard = hear(tracks, progress)
    learned = [each for each in heard if each.track.name not in names]
    if not learned:
        raise TrackError(f"{folder}: every recording is held out")
    progress("learning", 0, 1)
    model = fit_expression(learned, seed)
    progress("learning", 1, 1)
    figures: dict[str, object] = {
        "recordings": len(learned),
        "minutes": round(sum(each.track.n_frames for each in learned) / RATE_HZ / 60.0, 2),
        "held_out": None,
    }
    held_out = [each for each in heard if each.track.name in names]
    if len(held_out) >= 4:
        figures["held_out"] = measure_held_out(model, held_out, seed).as_json()
    return model, figures


def read_tracks(folder: Path, progress: Progress = nobody_watches) -> list[ExpressionTrack]:
    """The tracks of either kind of folder. Raises TrackError, CorpusError."""
    if (folder / "landmarks.json").is_file():
        return read_grid_tracks(folder, progress)
    return read_track_files(folder, progress)


def _held_out_names(folder: Path, tracks: Sequence[ExpressionTrack]) -> set[str]:
    path = folder / "splits.json"
    if not path.is_file():
        return {track.name for track in tracks[_HELD_OUT_EVERY - 1 :: _HELD_OUT_EVERY]}
    try:
        names = json.loads(path.read_text())["random_test"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TrackError(f"{path}: no list `random_test` of names ({error})") from error
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise TrackError(f"{path}: `random_test` is no list of names")
    return set(names)
