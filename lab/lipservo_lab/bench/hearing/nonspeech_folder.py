"""A folder of sounds that hold no speech, played to the street one by one."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from lipservo_lab.evaluation.recognition.nonspeech import (
    MouthDuringSound,
    mouth_during,
    nonspeech_figures,
)
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.audio.source import SoundError
from lipsync.errors import UserError
from lipsync.phonemes import LiveRecognizer


class NonspeechError(UserError):
    """A folder holds no sound that can be played; the message is one line."""


@dataclass(slots=True)
class NonspeechFolder:
    """mouths: by the name of the file below the folder; not_sound: what was left out, and why."""

    mouths: dict[str, MouthDuringSound] = field(default_factory=dict)
    not_sound: list[str] = field(default_factory=list)

    def figures(self) -> dict[str, float]:
        """Of all sounds together."""
        return nonspeech_figures(self.mouths.values())

    def figures_by_folder(self) -> dict[str, dict[str, float]]:
        """Of the sounds of each folder below; what lies beside the folders is in none."""
        grouped: dict[str, list[MouthDuringSound]] = defaultdict(list)
        for name, mouth in self.mouths.items():
            below = Path(name).parent.as_posix()
            if below != ".":
                grouped[below].append(mouth)
        return {below: nonspeech_figures(mouths) for below, mouths in sorted(grouped.items())}

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            **self.figures(),
            "folders": self.figures_by_folder(),
            "sounds": {name: nonspeech_figures([m]) for name, m in self.mouths.items()},
            "left_out": self.not_sound,
        }


def sound_files(folder: Path) -> list[Path]:
    """Every file in a folder and below it, hidden ones apart. Raises NonspeechError for none."""
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
    """Play every file, each as a new stream. Raises NonspeechError where none of them is sound."""
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
