"""Components that move too little in the mean move nearly as far as they did in the recordings.

An expectation is a mean over all that a context leaves open, and a mean moves less than what it is
a mean of: the finer a component, the less. Readers miss it: words that the mouth never learned are
read better when their fine shapes are as large as recorded ones (docs/motion.md). The gain is a
constant for each component, as in global variance compensation (Toda and Tokuda, IEICE
Transactions E90-D(5), 2007), so it costs nothing when the mouth moves.

What the live recogniser makes of training sentences: the expectation learns its errors.

The shipped recogniser has heard LibriSpeech only, no sentence with recorded motion: what it
mishears here it mishears live.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.utterance import Utterance, speech_frames
from lipsync.arrays import Array
from lipsync.audio.file import read_speech
from lipsync.audio.source import SoundError
from lipsync.expectation.expectation import Expectation, contexts, track_of
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.batch import TOGETHER, settled_phonemes
from lipsync.recognition.network import NetworkWeights

#: Of the recordings' deviation. Chosen on inner splits (docs/motion.md). What opens and spreads the
#: mouth has more of itself and stays as it is: exaggeration is read worse.
SHARE = 0.8
#: A component that hardly follows its context is not blown up.
_LARGEST_GAIN = 2.0
_LOOKAHEAD_S = 0.1


def with_deviation(
    expectation: Expectation, utterances: Sequence[Utterance], coefficients: Sequence[Array]
) -> Expectation:
    """Return the expectation with each component deviating by at least SHARE of the recorded.

    Deviations are those in speech from the mean of the sentence, since nothing that is heard tells
    a sentence's own offset.

    Parameters
    ----------
    expectation : Expectation
        Learned.
    utterances : Sequence[Utterance]
        Labelled.
    coefficients : Sequence[Array]
        (n_frames, n_components) of each.

    Returns
    -------
    Expectation
        Amplified where it deviates less.
    """
    expected, recorded = [], []
    for utterance, motion in zip(utterances, coefficients, strict=True):
        spoken = speech_frames(utterance)
        if not spoken.any():
            continue
        times_s = np.flatnonzero(spoken) / utterance.frame_rate_hz
        phonemes, known_s = contexts(track_of(utterance.phones), times_s, _LOOKAHEAD_S)
        ahead_s = np.full(len(times_s), _LOOKAHEAD_S)
        expected.append(expectation.faces(phonemes, known_s, ahead_s))
        recorded.append(motion[spoken])
    if not expected:
        return expectation
    return _amplified(expectation, *gain_and_mean(expected, recorded))


def gain_and_mean(
    expected: Sequence[Array], recorded: Sequence[Array], share: float = SHARE
) -> tuple[Array, Array]:
    """Return by how much each component is to deviate more, and from which mean.

    Parameters
    ----------
    expected,recorded : Sequence[Array]
        (n_frames, n_components) of the speech of each sentence.
    share : float
        Of the recorded deviation that is wanted.

    Returns
    -------
    tuple[Array, Array]
        (n_components,) each.
    """
    wanted = share * _deviation(recorded)
    gain = np.clip(wanted / np.maximum(_deviation(expected), 1e-9), 1.0, _LARGEST_GAIN)
    return gain, np.concatenate(expected).mean(axis=0)


def _deviation(sentences: Sequence[Array]) -> Array:
    """Return the rms deviation of each component from the mean of its sentence, (n_components,)."""
    squares = [(faces - faces.mean(axis=0)) ** 2 for faces in sentences]
    return np.asarray(np.sqrt(np.concatenate(squares).mean(axis=0)))


def _amplified(expectation: Expectation, gain: Array, mean: Array) -> Expectation:
    """Faces f become mean + gain (f - mean); both (n_components,)."""
    slots, windows = expectation.slots, expectation.windows
    by_slots, by_windows = slots.output * gain, windows.output * gain
    by_slots[-1] += (1.0 - gain) * mean
    return replace(
        expectation,
        slots=replace(slots, output=by_slots),
        windows=replace(windows, output=by_windows),
    )


Progress = Callable[[Sequence[Utterance]], Iterable[Utterance]]


def hear_sentences(
    weights: NetworkWeights, utterances: Sequence[Utterance], progress: Progress = iter
) -> dict[str, tuple[PhonemeEvent, ...]]:
    """Return the final phonemes of a live recogniser for every sentence whose sound can be read.

    The keys are the sentences' names.
    """
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
