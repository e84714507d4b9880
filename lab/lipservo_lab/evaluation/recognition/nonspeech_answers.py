"""How the mouth answers sounds without speech: how long, how often and how wide it opens.

The sounds are files of a folder, played to the live recogniser one by one.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lipservo_lab.evaluation.recognition.heard_motion import heard_motion
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.audio.source import SoundError
from lipsync.errors import UserError
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import LiveRecognizer

#: Lips this much further apart than at rest are open, mm.
OPEN_MM = 2.0


@dataclass(frozen=True, slots=True)
class MouthDuringSound:
    """What the mouth did during a sound without speech.

    seconds: length of the sound. open_s: time with open lips; speech_s: time recognised as speech;
    widest_mm: largest lip gap beyond the one at rest.
    """

    seconds: float
    open_s: float
    speech_s: float
    n_openings: int
    widest_mm: float


def mouth_during(
    sound: Path, recognizer: LiveRecognizer, model: TrainedModel, lookahead_s: float
) -> MouthDuringSound:
    """Run a recogniser, which is reset, and the live motion on a sound; return how the mouth moved.

    Open lips and speech count until the sound ends; openings and the widest gap also in the half
    second of silence after it. Raises SoundError for a file that is no sound.
    """
    motion = heard_motion(sound, recognizer, model, lookahead_s)
    gaps_mm = model.lip_gaps_mm(model.markers_mm(motion.faces))
    rest_mm = float(model.lip_gaps_mm(model.markers_mm(model.rest[None]))[0])
    is_open = gaps_mm > rest_mm + OPEN_MM
    within = motion.times_s < motion.sound_s
    return MouthDuringSound(
        seconds=motion.sound_s,
        open_s=TICK_S * int(is_open[within].sum()),
        speech_s=min(motion.spoken_s, motion.sound_s),
        n_openings=int(np.count_nonzero(np.diff(is_open.astype(np.int8), prepend=0) == 1)),
        widest_mm=float(gaps_mm.max() - rest_mm),
    )


def nonspeech_figures(mouths: Iterable[MouthDuringSound]) -> dict[str, float]:
    """Return shares of all sounds' time, openings a minute, and the widest opening of all."""
    found = list(mouths)
    seconds = sum(mouth.seconds for mouth in found)
    return {
        "open_share": sum(mouth.open_s for mouth in found) / seconds,
        "speech_share": sum(mouth.speech_s for mouth in found) / seconds,
        "openings_per_min": 60.0 * sum(mouth.n_openings for mouth in found) / seconds,
        "widest_mm": max(mouth.widest_mm for mouth in found),
        "files": len(found),
        "seconds": seconds,
    }


class NonspeechError(UserError):
    """A folder holds no sound that can be played; the message is one line."""


@dataclass(slots=True)
class NonspeechFolder:
    """The mouth during the sounds of a folder.

    mouths: by the file's path below the folder; not_sound: error of each file that was left out.
    """

    mouths: dict[str, MouthDuringSound] = field(default_factory=dict)
    not_sound: list[str] = field(default_factory=list)

    def figures(self) -> dict[str, float]:
        """Return the figures of all sounds together."""
        return nonspeech_figures(self.mouths.values())

    def figures_by_folder(self) -> dict[str, dict[str, float]]:
        """Return the figures of each subfolder; files beside the subfolders are in none."""
        grouped: dict[str, list[MouthDuringSound]] = defaultdict(list)
        for name, mouth in self.mouths.items():
            below = Path(name).parent.as_posix()
            if below != ".":
                grouped[below].append(mouth)
        return {below: nonspeech_figures(mouths) for below, mouths in sorted(grouped.items())}

    def as_dict(self) -> dict[str, object]:
        """Return all figures for JSON."""
        return {
            **self.figures(),
            "folders": self.figures_by_folder(),
            "sounds": {name: nonspeech_figures([m]) for name, m in self.mouths.items()},
            "left_out": self.not_sound,
        }


def sound_files(folder: Path) -> list[Path]:
    """Return all files in and below a folder but hidden ones. Raises NonspeechError for none."""
    if not folder.is_dir():
        raise NonspeechError(f"{folder}: no such folder; give one that holds sound files")
    files = sorted(
        path
        for path in folder.rglob("*")
        if path.is_file() and not any(p.startswith(".") for p in path.relative_to(folder).parts)
    )
    if not files:
        raise NonspeechError(f"{folder}: holds no file; give a folder of sound files")
    return files


def nonspeech_folder(
    folder: Path,
    files: Sequence[Path],
    recognizer: LiveRecognizer,
    model: TrainedModel,
    lookahead_s: float,
    progress: Callable[[int], None],
) -> NonspeechFolder:
    """Play every file, each as a new stream, and return what the mouth did.

    progress: called with the number of files done. Raises NonspeechError if none of them is sound.
    """
    found = NonspeechFolder()
    for number, path in enumerate(files, start=1):
        try:
            mouth = mouth_during(path, recognizer, model, lookahead_s)
            found.mouths[path.relative_to(folder).as_posix()] = mouth
        except SoundError as error:
            found.not_sound.append(str(error))
        progress(number)
    if not found.mouths:
        raise NonspeechError(f"{folder}: none of {len(files)} files is sound: {found.not_sound[0]}")
    return found
