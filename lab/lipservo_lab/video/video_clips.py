"""Videos to import, with their words; each is tracked and recognised, and cut at pauses if long."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from lipservo_lab.video.clip_labels import ClipLabels, label_clip
from lipservo_lab.video.face_track import FaceTrack, track_face, usual_step_s
from lipservo_lab.video.track_quality import track_fault
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phonemes import SILENCE
from lipsync.video.face_tracker import FaceTracker
from lipsync.video.video_file import VIDEO_ENDINGS, VideoError, VideoSound, video_sound


@dataclass(frozen=True, slots=True)
class VideoClip:
    """A video and its text; None: its words are not written down."""

    path: Path
    text: str | None

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem


def find_clips(source: Path) -> tuple[VideoClip, ...]:
    """Return one video file, or every video of a folder, in order of their names.

    A clip's text is in NAME.txt beside it, else after its name in transcripts.txt. Raises
    VideoError for a missing source, a folder without videos, two videos of one name, and a line of
    transcripts.txt that names none of them.
    """
    if source.is_file():
        return (VideoClip(source, _text_beside(source) or _texts(source.parent).get(source.stem)),)
    if not source.is_dir():
        raise VideoError(f"{source}: no such file or folder; give a video, or a folder of videos")
    paths = sorted(p for p in source.iterdir() if p.suffix.lower() in VIDEO_ENDINGS and p.is_file())
    if not paths:
        raise VideoError(f"{source}: has no video; looked for NAME with {' '.join(VIDEO_ENDINGS)}")
    names = [path.stem for path in paths]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise VideoError(f"{source}: two videos are called {twice[0]}; rename one")
    listed = _texts(source)
    if unknown := sorted(set(listed) - set(names)):
        raise VideoError(
            f"{source / 'transcripts.txt'}: {unknown[0]!r} is no video of the folder; each line "
            "is the NAME of one, without its ending, and what is said"
        )
    return tuple(VideoClip(path, _text_beside(path) or listed.get(path.stem)) for path in paths)


def _text_beside(video: Path) -> str | None:
    """Return the text in NAME.txt beside a video NAME; None if it is missing or empty."""
    path = video.with_suffix(".txt")
    return (_read(path).strip() or None) if path.is_file() else None


def _texts(folder: Path) -> dict[str, str]:
    """Return the texts in transcripts.txt of a folder by name; empty if the file is missing."""
    path = folder / "transcripts.txt"
    if not path.is_file():
        return {}
    lines = [line.strip().partition(" ") for line in _read(path).splitlines()]
    return {name: text.strip() for name, _, text in lines if name and text.strip()}


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise VideoError(f"{path}: cannot be read as text (UTF-8): {error}") from error


#: A longer video is cut, so that a bad second costs one sentence and not all.
_LONGEST_WHOLE_S = 15.0
#: Cuts are in the middle of silences of at least this length, if the part before is this long.
_PAUSE_S, _LEAST_PART_S = 0.25, 4.0


@dataclass(frozen=True, slots=True)
class Take:
    """A video with its tracked face, sound and labels.

    step_s: usual time from picture to picture.
    """

    name: str
    track: FaceTrack
    sound: VideoSound
    labels: ClipLabels
    step_s: float

    def parts(self) -> list[tuple[str, float, float]]:
        """Return name, start and end of each part, s of sound time; a short take is one part."""
        end_s = len(self.sound.samples) / SAMPLE_RATE_HZ
        if end_s <= _LONGEST_WHOLE_S:
            return [(self.name, 0.0, end_s)]
        cuts_s = [0.0]
        for phone in self.labels.phones[:-1]:  # nothing follows a pause at the end
            phone_end_s = phone.end_s or phone.start_s
            middle_s = (phone.start_s + phone_end_s) / 2
            is_pause = phone.phoneme == SILENCE and phone_end_s - phone.start_s >= _PAUSE_S
            if is_pause and middle_s - cuts_s[-1] >= _LEAST_PART_S:
                cuts_s.append(middle_s)
        cuts_s.append(end_s)
        return [
            (f"{self.name}-{number:03}", start_s, part_end_s)
            for number, (start_s, part_end_s) in enumerate(pairwise(cuts_s), start=1)
        ]


def record_take(clip: VideoClip, tracker: FaceTracker, advance: Callable[[float], None]) -> Take:
    """Track, recognise and label a clip.

    advance: called with the time of each picture, s. Raises VideoError or another UserError with
    the reason if the clip cannot be used.
    """
    sound = video_sound(clip.path)
    track = track_face(clip.path, tracker, advance)
    if len(track.times_s) < 2:
        raise VideoError(f"{clip.path}: holds fewer than two pictures; film longer")
    step_s = usual_step_s(track.times_s)
    if not (track.n_faces > 0).any():
        raise VideoError(f"{clip.path}: {track_fault(track, step_s)}")
    return Take(clip.name, track, sound, label_clip(sound.samples, clip.text), step_s)
