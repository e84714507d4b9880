"""One video, tracked and heard; cut at pauses where it is long."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from lipservo_lab.video.clip_labels import ClipLabels, label_clip
from lipservo_lab.video.face_track import FaceTrack, track_face
from lipservo_lab.video.picture_rate import usual_step_s
from lipservo_lab.video.track_quality import track_fault
from lipservo_lab.video.video_clips import VideoClip
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phonemes import SILENCE
from lipsync.video.tracking.face_tracker import FaceTracker
from lipsync.video.video_file import VideoError, VideoSound, video_sound

#: A video longer than this is cut, so that a bad second costs a sentence and not all.
_LONGEST_WHOLE_S = 15.0
#: Cut in the middle of a silence so long, once a part is so long.
_PAUSE_S, _LEAST_PART_S = 0.25, 4.0


@dataclass(frozen=True, slots=True)
class Take:
    """A video whose face and sound are known; step_s: usual time from picture to picture."""

    name: str
    track: FaceTrack
    sound: VideoSound
    labels: ClipLabels
    step_s: float

    def parts(self) -> list[tuple[str, float, float]]:
        """Name, start and end of each part, in sound time; the whole take where it is short."""
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
    """Track, hear and label a clip; `advance` is told how far it is, in seconds.

    Raises UserError, VideoError for one, with the reason why nothing of it can be used.
    """
    sound = video_sound(clip.path)
    track = track_face(clip.path, tracker, advance)
    if len(track.times_s) < 2:
        raise VideoError(f"{clip.path}: holds fewer than two pictures; film longer")
    step_s = usual_step_s(track.times_s)
    if not (track.n_faces > 0).any():
        raise VideoError(f"{clip.path}: {track_fault(track, step_s)}")
    return Take(clip.name, track, sound, label_clip(sound.samples, clip.text), step_s)
