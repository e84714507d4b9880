"""Sentences from video, written as a corpus: docs/motion.md, A corpus of your own."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import soundfile

from lipservo_lab.output_folder import check_output_folder, folder_written_whole
from lipservo_lab.video.tracked_lips import RIGID
from lipservo_lab.video.video_import import Sentence, VideoImport
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.face_mesh import INNER_LIP, IRISES, N_LANDMARKS, OUTER_LIP
from lipsync.textgrid import write_tiers

_UNITS_PER_PIXEL = 64
#: For cross-validation by `lipservo bench motion`, where there are enough sentences.
_FOLDS, _LEAST_FOR_FOLDS = 5, 10


def check_corpus_folder(folder: Path) -> None:
    """Refuse a place where no corpus could be written later. Raises OutputError."""
    check_output_folder(folder, "corpus")


def write_corpus(
    folder: Path,
    imported: VideoImport,
    about: Mapping[str, object],
    advance: Callable[[str, int, int], None],
    draw: Callable[[Path], None],
) -> None:
    """All of it or nothing. about: for import.json, beside the reports; draw: the picture sheet.

    Raises OutputError.
    """
    with folder_written_whole(folder) as place:
        for name in ("audio", "landmarks", "labels"):
            (place / name).mkdir()
        for number, sentence in enumerate(imported.sentences, start=1):
            _write_sentence(place, sentence)
            advance("writing", number, len(imported.sentences))
        _write_json(place / "landmarks.json", _landmark_list(imported.rate_hz))
        reports = [report.as_json() for report in imported.reports]
        _write_json(place / "import.json", {**about, "clips": reports})
        names = [sentence.name for sentence in imported.sentences]
        if len(names) >= _LEAST_FOR_FOLDS:
            folds = [names[first::_FOLDS] for first in range(_FOLDS)]
            _write_json(place / "splits.json", {"folds": folds, "new_words": {}})
        draw(place / "faces.png")


def _write_sentence(place: Path, sentence: Sentence) -> None:
    points = np.rint(sentence.clip.points * _UNITS_PER_PIXEL)
    # A picture more than 511 pixels wide needs more than 16 bits.
    small = np.abs(points).max() <= np.iinfo(np.int16).max
    whole = points.astype(np.int16 if small else np.int32)
    np.savez_compressed(place / "landmarks" / f"{sentence.name}.npz", landmarks_64th_px=whole)
    soundfile.write(
        place / "audio" / f"{sentence.name}.flac", sentence.clip.samples, SAMPLE_RATE_HZ
    )
    tiers = {name: tier for name, tier in sentence.labels.tiers().items() if tier}
    write_tiers(place / "labels" / f"{sentence.name}.TextGrid", tiers)


def _landmark_list(rate_hz: float) -> dict[str, object]:
    return {
        "frame_rate_hz": rate_hz,
        "landmark_ids": list(range(N_LANDMARKS)),
        "groups": {
            "rigid": list(RIGID),
            "lips_outer": list(OUTER_LIP),
            "lips_inner": list(INNER_LIP),
            "irises": list(IRISES),
        },
    }


def _write_json(path: Path, content: Mapping[str, object]) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
