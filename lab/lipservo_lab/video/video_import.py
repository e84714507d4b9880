"""Import videos of one speaker as the sentences of a corpus, each with a report.

The corpus: docs/motion.md, A corpus of your own.
"""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import soundfile

from lipservo.terminal.output import Advance
from lipservo_lab.output_folder import check_output_folder, folder_written_whole
from lipservo_lab.video.clip_labels import ClipLabels
from lipservo_lab.video.face_track import (
    RIGID,
    FaceSample,
    SteadyClip,
    picture_rate_hz,
    steady_clip,
    tracked_gaps_mm,
)
from lipservo_lab.video.sound_shift import ExpectedLips, ShiftCurve, corrections_s, shift_curve
from lipservo_lab.video.track_quality import ClipReport, quality_of, track_fault
from lipservo_lab.video.video_clips import Take, VideoClip, record_take
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.markers import INNER_LIP, IRISES, N_LANDMARKS, OUTER_LIP
from lipsync.phonemes import SILENCE
from lipsync.recognition.alignment import check_aligner
from lipsync.textgrid import write_tiers
from lipsync.video.face_tracker import FaceTracker
from lipsync.video.video_file import VideoError, video_duration_s

#: A clip with fewer pictures is not used.
_LEAST_PICTURES = 10
#: With a lower correlation, at the shift that is applied, the sound is not of these lips.
_LEAST_GAP_R = 0.2
_LEAST_SPEECH_S = 0.3


@dataclass(frozen=True, slots=True)
class Sentence:
    """A clip as a corpus stores it."""

    name: str
    clip: SteadyClip
    labels: ClipLabels


@dataclass(frozen=True, slots=True)
class VideoImport:
    """The result of an import.

    sentences: the clips that can be used; reports: of every clip, in order; samples: for the
    picture sheet.
    """

    rate_hz: float
    sentences: tuple[Sentence, ...]
    reports: tuple[ClipReport, ...]
    samples: tuple[tuple[FaceSample, ClipReport], ...]


@dataclass(frozen=True, slots=True)
class _Part:
    """A part of a take whose pictures can be used.

    steady: its pictures and sound before the sound is moved. curve: correlation of lips and sound.
    """

    name: str
    take: Take
    start_s: float
    end_s: float
    steady: SteadyClip
    curve: ShiftCurve


def import_videos(
    clips: Sequence[VideoClip], tracker: FaceTracker, advance: Advance
) -> VideoImport:
    """Track and recognise clips, and synchronise picture and sound.

    Raises VideoError if nothing is usable; MissingExtraError if there are texts and the extra
    `align` is not installed.
    """
    if any(clip.text is not None for clip in clips):
        check_aligner()
    reports: dict[str, ClipReport] = {}
    takes = _takes(clips, tracker, advance, reports)
    rate_hz = _common_rate_hz(takes)
    parts: list[_Part] = []
    lips = ExpectedLips()
    for number, take in enumerate(takes, start=1):
        parts += _parts(take, rate_hz, lips, reports)
        advance("comparing lips and sound", number, len(takes))
    sentences, samples = [], []
    shifts_s = corrections_s([part.curve for part in parts])
    for part, shift_s in zip(parts, shifts_s, strict=True):
        sentence, reports[part.name] = _as_sentence(part, shift_s)
        if sentence is not None:
            sentences.append(sentence)
    for take in takes:
        for name, start_s, end_s in take.parts():
            begins_s = take.sound.begins_s
            track = take.track.between(begins_s + start_s, begins_s + end_s)
            samples += [(sample, reports[name]) for sample in track.samples[:1]]
    if not sentences:
        raise VideoError(f"no clip can be used: {_first_reasons(tuple(reports.values()))}")
    return VideoImport(rate_hz, tuple(sentences), tuple(reports.values()), tuple(samples))


def _takes(
    clips: Sequence[VideoClip],
    tracker: FaceTracker,
    advance: Advance,
    reports: dict[str, ClipReport],
) -> list[Take]:
    """Track the face in each clip; return the clips that succeed, with sound and labels.

    Clips that fail get a report with the reason in `reports`.
    """
    lengths_s = [_length_s(clip) for clip in clips]
    takes = []
    for number, clip in enumerate(clips):
        before_s, all_s = sum(lengths_s[:number]), max(1.0, sum(lengths_s))

        def report(time_s: float, before_s: float = before_s, all_s: float = all_s) -> None:
            advance("tracking", round(before_s + time_s), round(all_s))

        try:
            takes.append(record_take(clip, tracker, report))
        except UserError as error:
            reason = str(error).removeprefix(f"{clip.path}: ")
            reports[clip.name] = ClipReport(clip.name, left_out=reason)
    return takes


def _length_s(clip: VideoClip) -> float:
    """Return the duration of a video, s; 0 if it cannot be read."""
    try:
        return video_duration_s(clip.path)
    except VideoError:  # reported later, when it is tracked
        return 0.0


def _common_rate_hz(takes: Sequence[Take]) -> float:
    """Return the frame rate of most clips; of several equally frequent ones the highest."""
    counts = Counter(picture_rate_hz(take.track.times_s) for take in takes)
    return max(counts, key=lambda rate_hz: (counts[rate_hz], rate_hz), default=25.0)


def _parts(
    take: Take, rate_hz: float, lips: ExpectedLips, reports: dict[str, ClipReport]
) -> list[_Part]:
    """Return the parts of a take that can be used, each with how its lips follow the sound.

    Parts that cannot be used get a report with the reason. lips: predicts the lip gap from
    phonemes.
    """
    found = []
    expected_mm = lips.gaps_mm(take.labels.phones, take.parts()[-1][2])
    for name, start_s, end_s in take.parts():
        reports[name] = ClipReport(name)  # keeps the order
        begins_s = take.sound.begins_s
        track = take.track.between(begins_s + start_s, begins_s + end_s)
        fault = track_fault(track, take.step_s)
        if fault is not None:
            reports[name] = replace(_picture_report(name, take, start_s, end_s), left_out=fault)
            continue
        steady = steady_clip(track, take.sound, rate_hz)
        if len(steady.points) < _LEAST_PICTURES:
            reason = f"only {len(steady.points)} pictures have sound; film longer"
            reports[name] = ClipReport(name, left_out=reason)
            continue
        tracked_mm = tracked_gaps_mm(steady.points)
        times_s = steady.from_s + np.arange(len(tracked_mm)) / rate_hz
        curve = shift_curve(tracked_mm, times_s, expected_mm)
        found.append(_Part(name, take, start_s, end_s, steady, curve))
    return found


def _picture_report(name: str, take: Take, start_s: float, end_s: float) -> ClipReport:
    """Return the report of a part with what its pictures show."""
    begins_s = take.sound.begins_s
    quality = quality_of(take.track.between(begins_s + start_s, begins_s + end_s))
    report = ClipReport(name, phonemes=take.labels.source, text_score=take.labels.score)
    if not quality.seen:
        return report
    return replace(
        report,
        eye_distance_px=round(quality.eye_distance_px, 1),
        yaw_deg=round(quality.yaw_deg, 1),
        pitch_deg=round(quality.pitch_deg, 1),
    )


def _as_sentence(part: _Part, shift_s: float) -> tuple[Sentence | None, ClipReport]:
    """Return a part as a sentence with its sound moved `shift_s` earlier, and its report.

    The sentence is None if the part cannot be learned from.
    """
    take = part.take
    sound = replace(take.sound, begins_s=take.sound.begins_s - shift_s)
    begins_s = take.sound.begins_s
    track = take.track.between(begins_s + part.start_s, begins_s + part.end_s)
    clip = steady_clip(track, sound, part.steady.rate_hz)
    seconds = len(clip.points) / clip.rate_hz
    labels = take.labels.within(clip.from_s, seconds)
    report = replace(
        _picture_report(part.name, take, part.start_s, part.end_s),
        seconds=round(seconds, 2),
        shift_ms=round(1e3 * part.curve.best_s),
        corrected_ms=round(1e3 * shift_s),
        gap_r=round(gap_r := part.curve.at(shift_s), 3),
        notes=tuple(_notes(take, clip, shift_s)),
    )
    reason = _unusable(clip, labels, gap_r)
    if reason is not None:
        return None, replace(report, left_out=reason)
    return Sentence(part.name, clip, labels), report


def _unusable(clip: SteadyClip, labels: ClipLabels, gap_r: float) -> str | None:
    """Return why a part cannot be learned from (short, no speech, other lips); None: it can.

    gap_r: how its lip gap correlates with that expected of its sound, shifted as it will be.
    """
    if len(clip.points) < _LEAST_PICTURES:
        return f"only {len(clip.points)} pictures have sound; film longer"
    spoken_s = sum(
        (p.end_s or p.start_s) - p.start_s for p in labels.phones if p.phoneme != SILENCE
    )
    if spoken_s < _LEAST_SPEECH_S:
        return f"only {spoken_s:.1f} s of speech here"
    if gap_r < _LEAST_GAP_R:
        return (
            f"the lips do not follow the sound (r = {gap_r:.2f}): it is somebody else's "
            "voice, or the mouth is hidden"
        )
    return None


def _notes(take: Take, clip: SteadyClip, shift_s: float) -> list[str]:
    """Return notes for a used part: corrected shift, interpolated pictures, doubtful text.

    shift_s: how much later than the picture the sound was, s.
    """
    notes = []
    if shift_s:
        later = "later" if shift_s > 0 else "earlier"
        notes.append(f"sound {abs(1e3 * shift_s):.0f} ms {later} than the picture: put right")
    if not clip.was_steady:
        notes.append(
            f"pictures at uneven times or another rate: points interpolated at {clip.rate_hz:g} Hz"
        )
    if take.labels.is_doubtful:
        notes.append(
            f"the text fits badly (score {take.labels.score}): words may be missing or too many"
        )
    return notes


def _first_reasons(reports: Sequence[ClipReport]) -> str:
    """Return the first three reasons for clips left out, and how many more there are."""
    reasons = [f"{report.clip}: {report.left_out}" for report in reports if report.left_out]
    more = f"; and {len(reasons) - 3} more" if len(reasons) > 3 else ""
    return "; ".join(reasons[:3]) + more


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
    advance: Advance,
    draw: Callable[[Path], None],
) -> None:
    """Write the corpus completely or not at all. Raises OutputError.

    about: content of import.json besides the reports. draw: called with the path of the picture
    sheet, to draw it.
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
    """Write a sentence's landmarks, sound and labels into a corpus folder.

    Landmarks are whole numbers of 1/64 pixel.
    """
    points = np.rint(sentence.clip.points * _UNITS_PER_PIXEL)
    # A picture more than 511 pixels wide needs more than 16 bits.
    fits_int16 = np.abs(points).max() <= np.iinfo(np.int16).max
    units = points.astype(np.int16 if fits_int16 else np.int32)
    np.savez_compressed(place / "landmarks" / f"{sentence.name}.npz", landmarks_64th_px=units)
    soundfile.write(
        place / "audio" / f"{sentence.name}.flac", sentence.clip.samples, SAMPLE_RATE_HZ
    )
    tiers = {name: tier for name, tier in sentence.labels.tiers().items() if tier}
    write_tiers(place / "labels" / f"{sentence.name}.TextGrid", tiers)


def _landmark_list(rate_hz: float) -> dict[str, object]:
    """Return the content of landmarks.json: frame rate, and which landmarks form which group."""
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
