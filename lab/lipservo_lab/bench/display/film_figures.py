"""Films by what is in their files: sound against picture, and their pixels.

The pixels are looked at by the tracker that imports video, as if the film were one of a talker.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import soundfile

from lipservo.display.film import Display, film, write_film
from lipservo.terminal.output import Advance
from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.readability.readers import (
    LIP_READER,
    Motions,
    known_fold,
    read_words,
    slotted,
)
from lipservo_lab.evaluation.readability.reading_scores import (
    known_score,
    recorded_motions,
    seen_motions,
)
from lipservo_lab.video.face_track import RIGID
from lipsync.arrays import Array
from lipsync.face.frame import Frame
from lipsync.face.head_motion import apply_similarity, fit_similarity, refine_mean
from lipsync.face.model import FaceModel
from lipsync.markers import CLOSED_GAP_MM
from lipsync.video.face_tracker import FaceTracker
from lipsync.video.video_file import video_pictures, video_sound

_RATE_HZ = 25
_SYNC_SIZE, _SYNC_PICTURES, _FLASHES = (320, 240), 100, (10, 33, 57, 84)
#: Still pictures before the first sentence of a film, from which the tracker's zero is taken.
_STILL = 5
_EYES, _EYE_DISTANCE_MM = (RIGID.index(33), RIGID.index(263)), 90.0
_TO_FACE_AXES = np.array([1.0, -1.0, -1.0])
_LIPS_MEET = ("P", "B", "M")


def film_sync_ms() -> float:
    """Make a film of flashes with clicks; return the longest time from flash to click, ms."""
    rate_hz = 48_000
    clicks = np.zeros(_SYNC_PICTURES * rate_hz // _RATE_HZ, dtype=np.float32)
    for n in _FLASHES:
        first = n * rate_hz // _RATE_HZ
        clicks[first : first + 48] = np.hanning(48) * 0.9
    dark = np.zeros((_SYNC_SIZE[1], _SYNC_SIZE[0], 3), dtype=np.uint8)
    pictures = (dark + 255 if n in _FLASHES else dark for n in range(_SYNC_PICTURES))
    with tempfile.TemporaryDirectory() as folder:
        sound, out = Path(folder) / "clicks.wav", Path(folder) / "film.mp4"
        soundfile.write(sound, clicks, rate_hz)
        write_film(pictures, _SYNC_SIZE, sound, out)
        flashes_s = [time_s for time_s, picture in video_pictures(out) if picture.mean() > 128]
        film_sound = video_sound(out)
    # Times of the loud samples; a click is loudest half a millisecond after its beginning.
    clicks_s = np.flatnonzero(np.abs(film_sound.samples) > 0.2) / 16_000 + film_sound.begins_s
    return max(1e3 * float(np.abs(clicks_s - flash_s - 0.0005).min()) for flash_s in flashes_s)


def tracked_film(
    display: Display,
    face: FaceModel,
    motions: Mapping[str, Array],
    tracker: FaceTracker,
    advance: Advance,
) -> dict[str, Array]:
    """Film all sentences in one film, and track the face in its pictures.

    Parameters
    ----------
    display : Display
        Draws the face of a frame.
    face : FaceModel
        The model of the frames.
    motions : Mapping[str, Array]
        (n, n_components) by sentence, at the film's rate.
    tracker : FaceTracker
        Finds the points of a face in a picture.
    advance : Advance
        Called with the progress.

    Returns
    -------
    dict[str, Array]
        Points (n, 478, 3) in pixels by sentence, and under `rest` those of the still pictures at
        the beginning; NaN where no face was found.
    """
    frames = [Frame(0.0, face.rest)] * _STILL
    frames += [Frame(0.0, each) for shown in motions.values() for each in shown]
    points: list[Array] = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "film.mp4"
        film(frames, None, display, out, progress=lambda n: advance("filming", n, len(frames)))
        for _, picture in video_pictures(out):
            faces = tracker.faces(picture)
            points.append(faces[0] if faces else np.full((478, 3), np.nan))
            advance("tracking", len(points), len(frames))
    return cut_track(np.stack(points), motions)


def cut_track(points: Array, motions: Mapping[str, Array]) -> dict[str, Array]:
    """Return the points of a film sentence by sentence, and of the still pictures before them.

    Parameters
    ----------
    points : Array
        (n_pictures, 478, 3).
    motions : Mapping[str, Array]
        (n, n_components) by sentence, in the order of the film.

    Returns
    -------
    dict[str, Array]
        (n, 478, 3) by sentence, and under `rest` the still pictures.
    """
    points_of, first = {"rest": points[:_STILL]}, _STILL
    for name, shown in motions.items():
        points_of[name] = points[first : first + len(shown)]
        first += len(shown)
    return points_of


def seen_figures(
    face: FaceModel,
    tracks: Mapping[str, Array],
    motions: Mapping[str, Array],
    sentences: Sequence[Utterance],
) -> dict[str, object]:
    """Compare lip gaps, closures and words read in tracked films with those of the filmed frames.

    The reader of words learns from the other sentences as they were recorded.

    Parameters
    ----------
    face : FaceModel
        The model.
    tracks : Mapping[str, Array]
        (n, 478, 3) by sentence, as `tracked_film` returns them.
    motions : Mapping[str, Array]
        The filmed frames, (n, n_components) by sentence; the reader has not learned these
        sentences.
    sentences : Sequence[Utterance]
        All sentences of the corpus.

    Returns
    -------
    dict[str, object]
        gap_r: correlation of the gaps; pbm_shut: share of P, B and M closed in the frames that are
        closed in the film, 0 to 1; read_...: scores of the reader.
    """
    markers = _face_markers_mm(face, tracks)
    wanted_gaps = {
        name: face.lip_gaps_mm(face.markers_mm(shown)) for name, shown in motions.items()
    }
    # Lips touch at rest: what a tracker says of them there is its zero.
    rest_gap_mm = float(np.median(face.lip_gaps_mm(markers["rest"])))
    seen_gaps = {name: face.lip_gaps_mm(markers[name]) - rest_gap_mm for name in motions}
    n_closed, n_wanted = 0, 0
    for sentence in sentences:
        if sentence.name not in motions:
            continue
        for phone in sentence.phones:
            if phone.phoneme not in _LIPS_MEET:
                continue
            first, last = round(phone.start_s * _RATE_HZ), round((phone.end_s or 0.0) * _RATE_HZ)
            # The pictures from one before the phone to one after it.
            during = slice(max(0, first - 1), last + 2)
            if (
                len(wanted_gaps[sentence.name][during])
                and wanted_gaps[sentence.name][during].min() < CLOSED_GAP_MM
            ):
                n_wanted += 1
                n_closed += bool(seen_gaps[sentence.name][during].min() < CLOSED_GAP_MM)
    wanted, shown = (
        np.concatenate([each[name] for name in motions]) for each in (wanted_gaps, seen_gaps)
    )
    readable = slotted(sentences)
    recorded = recorded_motions(face, readable, LIP_READER)
    folds = known_fold(LIP_READER, readable, frozenset(motions), recorded)

    def score(made: Motions) -> float:
        return float(known_score(read_words(folds, made, recorded)).score)

    of_frames = score(seen_motions(face, motions, LIP_READER))
    of_film = score({name: LIP_READER.view(face, markers[name]) for name in motions})
    return {
        "gap_r": round(float(np.corrcoef(wanted, shown)[0, 1]), 4),
        "pbm_shut": round(n_closed / max(1, n_wanted), 4),
        "pbm_asked": n_wanted,
        "read_frames": round(of_frames, 4),
        "read_film": round(of_film, 4),
        "read_loss": round(of_film - of_frames, 4),
        "pictures_tracked": int(sum(np.isfinite(each[:, 0, 0]).sum() for each in tracks.values())),
    }


def _face_markers_mm(face: FaceModel, tracks: Mapping[str, Array]) -> dict[str, Array]:
    """Return the model's markers as tracked, (n, n_markers, 3) mm by sentence.

    Head motion is removed; each marker is moved from the model's rest as it moved from the film's.
    """
    rigid_points = np.concatenate([each[:, RIGID] for each in tracks.values()]) * _TO_FACE_AXES
    mean = refine_mean(rigid_points, (*_EYES, _EYE_DISTANCE_MM))
    chosen = list(face.layout.landmarks)
    placed = {}
    for name, points in tracks.items():
        at = points * _TO_FACE_AXES
        placed[name] = apply_similarity(at[:, chosen], *fit_similarity(at[:, RIGID], mean))
    film_rest = placed["rest"].mean(axis=0)
    model_rest = face.markers_mm(face.rest[None])[0]
    _, rotation, _ = fit_similarity(film_rest[None], model_rest)
    return {name: model_rest + (each - film_rest) @ rotation[0].T for name, each in placed.items()}


def held_out(corpus: Path) -> frozenset[str]:
    """Return the names of the sentences in `random_test` of a corpus's `splits.json`."""
    return frozenset(json.loads((corpus / "splits.json").read_text())["random_test"])
