"""The figures of `lipservo bench motion --video`: our mouth beside faces that no model trained on.

A clip's sound alone drives our mouth, through the street that a replay goes. Its lip gap is
compared with the one tracked in the pictures, in frames of speech, as both were filmed: a shift
between them is reported and not put right in the headline.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import soundfile
from numpy.typing import NDArray

from lipservo.commands.options import DEFAULT_FACE
from lipservo.rendering.spoken_sound import SpokenSound, spoken_sound
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.terminal.output import Advance
from lipservo_lab.video.face_track import FaceTrack, track_face, tracked_gaps_mm, usual_step_s
from lipservo_lab.video.sound_shift import ShiftCurve, correlation, shift_curve
from lipservo_lab.video.track_quality import picture_fault, usable_pictures
from lipservo_lab.video.video_clips import VideoClip
from lipsync.arrays import Array
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.face.model import FaceModel, load_face
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.video.face_tracker import FaceTracker
from lipsync.video.video_file import VideoError, VideoSound, video_sound

#: Of fewer pictures of speech no correlation is told.
_LEAST_PICTURES = 10
#: Loudness: level of so much sound around a picture, no lower than so far below the loudest.
_LOUDNESS_S, _FLOOR_DB = 0.06, 40.0


@dataclass(frozen=True, slots=True)
class ComparedClip:
    """How well our lip gap correlates with that of a filmed person, in the pictures of speech.

    gap_r, loudness_r: correlation of the tracked gap with our gap, and with the sound's loudness.
    curve: correlation of the two gaps when the pictures are compared with later sound, by shift.
    seconds, n_pictures: how much was compared. left_out: why nothing was; all else is empty then.
    """

    name: str
    gap_r: float = 0.0
    loudness_r: float = 0.0
    curve: ShiftCurve | None = None
    seconds: float = 0.0
    n_pictures: int = 0
    left_out: str | None = None

    def as_json(self) -> dict[str, object]:
        """Return the figures by the names of docs/own-face.md; None where the clip was left out."""
        if self.curve is None:
            return {"clip": self.name, "seconds": 0.0, "left_out": self.left_out} | dict.fromkeys(
                ("gap_r", "loudness_r", "best_shift_ms", "gap_r_at_best")
            )
        return {
            "clip": self.name,
            "gap_r": round(self.gap_r, 4),
            "loudness_r": round(self.loudness_r, 4),
            "best_shift_ms": round(1e3 * self.curve.best_s),
            "gap_r_at_best": round(float(self.curve.correlations.max()), 4),
            "seconds": round(self.seconds, 2),
            "left_out": None,
        }


def foreign_figures(
    clips: Sequence[VideoClip], tracker: FaceTracker, model: Path | None, advance: Advance
) -> dict[str, object]:
    """Compare our mouth with the face in every clip; return figures of all clips and of each.

    A clip that cannot be used is in the list with the reason. model: file of the face model; None:
    the shipped one. Raises VideoError where no clip can be used.
    """
    face = load_face(model)
    comparisons = []
    for number, clip in enumerate(clips, start=1):
        try:
            comparisons.append(_compare_clip(clip, tracker, face, model))
        except UserError as error:
            reason = str(error).removeprefix(f"{clip.path}: ")
            comparisons.append(ComparedClip(clip.name, left_out=reason))
        advance("comparing", number, len(clips))
    usable = [each for each in comparisons if each.curve is not None]
    if not usable:
        raise VideoError(f"no clip can be used: {comparisons[0].name}: {comparisons[0].left_out}")
    return {
        **pooled_figures(usable),
        "tracker": tracker.name,
        "clips": [each.as_json() for each in comparisons],
    }


def pooled_figures(compared: Sequence[ComparedClip]) -> dict[str, object]:
    """Return correlations of all clips together: means, weighted by their pictures of speech.

    So each clip's gaps count as if scaled to mean 0 and standard deviation 1. `best_shift_ms`: the
    one shift with the best mean correlation. compared: clips that have a curve.
    """
    weights = np.array([each.n_pictures for each in compared], dtype=float)
    weights /= weights.sum()
    curves = [each.curve for each in compared if each.curve is not None]
    mean_correlations = weights @ np.stack([curve.correlations for curve in curves])
    mean_curve = ShiftCurve(curves[0].shifts_s, mean_correlations)
    return {
        "gap_r": round(float(weights @ [each.gap_r for each in compared]), 4),
        "loudness_r": round(float(weights @ [each.loudness_r for each in compared]), 4),
        "best_shift_ms": round(1e3 * mean_curve.best_s),
        "gap_r_at_best": round(float(mean_correlations.max()), 4),
        "seconds": round(sum(each.seconds for each in compared), 2),
        "speech_pictures": sum(each.n_pictures for each in compared),
    }


def _compare_clip(
    clip: VideoClip, tracker: FaceTracker, face: FaceModel, model: Path | None
) -> ComparedClip:
    """Compare our lip gap for a clip's sound with the gap that is tracked in its pictures.

    model: file of the face model that speaks, loaded as `face`; None: the shipped one. Raises
    UserError for unusable sound or pictures, VideoError for too few pictures of one face.
    """
    sound = video_sound(clip.path)
    track = track_face(clip.path, tracker, lambda _time_s: None)
    usable = usable_pictures(track)
    if usable.sum() < _LEAST_PICTURES:
        step_s = usual_step_s(track.times_s) if len(track.times_s) > 1 else 0.0
        raise VideoError(picture_fault(track, step_s) or "too few pictures of one face")
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{clip.name}.wav"
        soundfile.write(path, sound.samples, SAMPLE_RATE_HZ)
        spoken_clip = spoken_sound(path, None, ChosenMotion(), DEFAULT_FACE, model)
        ours_mm, events = _our_gaps_mm(spoken_clip, face), spoken_clip.events()
    return compare(clip.name, _times_and_gaps(track, usable, sound), sound, ours_mm, events)


def _our_gaps_mm(spoken: SpokenSound, face: FaceModel) -> Array:
    """Return our lip gap, (n,) mm, every 10 ms of the sound."""
    times_s = TICK_S * np.arange(max(1, int(spoken.duration_s / TICK_S)), dtype=np.float64)
    faces = np.array([frame.coefficients for frame in spoken.frames(times_s)])
    return face.lip_gaps_mm(face.markers_mm(faces))


def _times_and_gaps(
    track: FaceTrack, usable: NDArray[np.bool_], sound: VideoSound
) -> tuple[Array, Array]:
    """Return sound times (s) and lip gaps (mm), (n,) each, of the pictures that can be used.

    usable: (n_pictures,), which those are.
    """
    return track.times_s[usable] - sound.begins_s, tracked_gaps_mm(track.points[usable])


def compare(
    name: str,
    pictures: tuple[Array, Array],
    sound: VideoSound,
    ours_mm: Array,
    events: Sequence[PhonemeEvent],
) -> ComparedClip:
    """Correlate our lip gap with a tracked one, in the pictures taken during speech.

    Parameters
    ----------
    name : str
        The clip's name.
    pictures : tuple[Array, Array]
        Sound times in s (n,) and tracked lip gaps in mm (n,).
    sound : VideoSound
        The clip's sound.
    ours_mm : Array
        (m,), our lip gap every 10 ms of the sound.
    events : Sequence[PhonemeEvent]
        The phonemes in the sound; speech is where they are not silence.

    Returns
    -------
    ComparedClip
        Correlations; `left_out` is set where there are too few pictures of speech.
    """
    times_s, tracked_mm = pictures
    in_speech = np.zeros(len(times_s), dtype=bool)
    for event in events:
        if event.phoneme != SILENCE and event.end_s is not None:
            in_speech |= (times_s >= event.start_s) & (times_s < event.end_s)
    in_speech &= (times_s >= 0) & (times_s <= (len(ours_mm) - 1) * TICK_S)
    if in_speech.sum() < _LEAST_PICTURES:
        return ComparedClip(
            name, left_out=f"only {in_speech.sum()} pictures of speech; film longer, speak up"
        )
    picture_s, gaps_mm = times_s[in_speech], tracked_mm[in_speech]
    ours_s = np.arange(len(ours_mm)) * TICK_S
    levels_db = loudness_db(sound.samples)
    return ComparedClip(
        name,
        correlation(gaps_mm, np.interp(picture_s, ours_s, ours_mm)),
        correlation(gaps_mm, np.interp(picture_s, np.arange(len(levels_db)) * TICK_S, levels_db)),
        shift_curve(gaps_mm, picture_s, ours_mm),
        len(times_s) * usual_step_s(times_s),
        int(in_speech.sum()),
    )


def loudness_db(samples: NDArray[np.float32]) -> Array:
    """Return the loudness of a sound every 10 ms: its mean power in 60 ms around each instant.

    Parameters
    ----------
    samples : NDArray[np.float32]
        (m,) at 16 kHz, -1 to 1.

    Returns
    -------
    Array
        (n,) dB of full scale, none lower than 40 dB below the loudest.
    """
    n_around = round(_LOUDNESS_S * SAMPLE_RATE_HZ)
    squares = np.pad(samples.astype(float) ** 2, n_around // 2)
    sums = np.concatenate(([0.0], np.cumsum(squares)))
    power = (sums[n_around:] - sums[:-n_around]) / n_around
    levels: Array = 10 * np.log10(power[:: round(TICK_S * SAMPLE_RATE_HZ)] + 1e-12)
    return np.asarray(np.maximum(levels, levels.max() - _FLOOR_DB))
