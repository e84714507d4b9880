"""What the live recogniser makes of training sentences: the expectation learns its errors.

The shipped recogniser has heard LibriSpeech only, no sentence with recorded motion: what it
mishears here it mishears live.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.utterance import Utterance
from lipsync.audio.source import SoundError
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.batch import TOGETHER, settled_phonemes
from lipsync.recognition.network import NetworkWeights
from lipsync.recognition.speech_file import read_speech

Progress = Callable[[Sequence[Utterance]], Iterable[Utterance]]


def hear_sentences(
    weights: NetworkWeights, utterances: Sequence[Utterance], progress: Progress = iter
) -> dict[str, tuple[PhonemeEvent, ...]]:
    """The phonemes of every sentence whose sound can be read, by name, as they are final live."""
    names: list[str] = []
    recordings: list[NDArray[np.float32]] = []
    heard: dict[str, tuple[PhonemeEvent, ...]] = {}

    def hear() -> None:
        with threadpool_limits(limits=1):  # several threads add up in changing order
            heard.update(zip(names, settled_phonemes(weights, recordings), strict=True))
        names.clear()
        recordings.clear()

    for utterance in progress(utterances):
        try:
            recordings.append(read_speech(utterance.sound_path))
        except SoundError:
            continue  # silent or damaged: its labels still teach
        names.append(utterance.name)
        if len(recordings) == TOGETHER:
            hear()
    hear()
    return heard
