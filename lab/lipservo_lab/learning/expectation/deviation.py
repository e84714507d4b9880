"""Amplify the predicted mean motion of components that move less than they did in the recordings.

An expectation predicts the mean face of all recorded ones with the same phonemes nearby, and a mean
moves less than what it is a mean of: the finer a component, the less. Lip readers miss that motion:
words that the mouth never learned are read better when their fine shapes are as large as recorded
ones (docs/motion.md). The gain is a constant for each component, as in global variance compensation
(Toda and Tokuda, IEICE Transactions E90-D(5), 2007), so it costs nothing when the mouth moves.

`hear_sentences`: the phonemes that the live recogniser finds in training sentences, so that the
expectation learns its errors. The shipped recogniser was trained on LibriSpeech only, on no
sentence with recorded motion: what it mishears here it mishears live.
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
    """Return the expectation, amplified so that its motion deviates nearly as much as the recorded.

    Each component deviates by at least SHARE of the recorded deviation, as far as `_LARGEST_GAIN`
    allows. Deviations are rms values of frames with speech from the mean of their sentence, since
    nothing in the sound or text tells a sentence's own offset.

    Parameters
    ----------
    expectation : Expectation
        Predicts the mean motion of phonemes, as learned.
    utterances : Sequence[Utterance]
        Sentences with phone labels.
    coefficients : Sequence[Array]
        Recorded face coefficients (n_frames, n_components) of each sentence.

    Returns
    -------
    Expectation
        With larger outputs where it deviates too little; unchanged if no sentence has speech.
    """
    expected, recorded = [], []
    for utterance, motion in zip(utterances, coefficients, strict=True):
        spoken = speech_frames(utterance)
        if not spoken.any():
            continue
        times_s = np.flatnonzero(spoken) / utterance.frame_rate_hz
        phonemes, context_times_s = contexts(track_of(utterance.phones), times_s, _LOOKAHEAD_S)
        lookaheads_s = np.full(len(times_s), _LOOKAHEAD_S)
        expected.append(expectation.faces(phonemes, context_times_s, lookaheads_s))
        recorded.append(motion[spoken])
    if not expected:
        return expectation
    return _amplified(expectation, *gain_and_mean(expected, recorded))


def gain_and_mean(
    expected: Sequence[Array], recorded: Sequence[Array], share: float = SHARE
) -> tuple[Array, Array]:
    """Return the gain that each component needs, and the mean that deviations are amplified from.

    Parameters
    ----------
    expected, recorded : Sequence[Array]
        Predicted and recorded coefficients (n_frames, n_components) of the speech of each sentence.
    share : float
        The share of the recorded deviation that the predicted one shall reach.

    Returns
    -------
    tuple[Array, Array]
        (n_components,) each: gains from 1 to `_LARGEST_GAIN`, and the mean predicted face.
    """
    target_deviation = share * _deviation(recorded)
    gain = np.clip(target_deviation / np.maximum(_deviation(expected), 1e-9), 1.0, _LARGEST_GAIN)
    return gain, np.concatenate(expected).mean(axis=0)


def _deviation(sentences: Sequence[Array]) -> Array:
    """Return the rms deviation of each component from the mean of its sentence, (n_components,)."""
    squares = [(faces - faces.mean(axis=0)) ** 2 for faces in sentences]
    return np.asarray(np.sqrt(np.concatenate(squares).mean(axis=0)))


def _amplified(expectation: Expectation, gain: Array, mean: Array) -> Expectation:
    """Return the expectation with faces f replaced by mean + gain (f - mean).

    gain, mean: (n_components,). The constant (1 - gain) mean goes into one bias, the last row of
    `slots.output`, because the outputs of both families of networks are added.
    """
    slots, windows = expectation.slots, expectation.windows
    slots_output, windows_output = slots.output * gain, windows.output * gain
    slots_output[-1] += (1.0 - gain) * mean
    return replace(
        expectation,
        slots=replace(slots, output=slots_output),
        windows=replace(windows, output=windows_output),
    )


Progress = Callable[[Sequence[Utterance]], Iterable[Utterance]]


def hear_sentences(
    weights: NetworkWeights, utterances: Sequence[Utterance], progress: Progress = iter
) -> dict[str, tuple[PhonemeEvent, ...]]:
    """Return the phonemes that a live recogniser finally decides on, by the sentence's name.

    Sentences whose sound cannot be read are left out. weights: of the recogniser. progress: wraps
    the sentences, to report how far the work is.
    """
    names: list[str] = []
    recordings: list[NDArray[np.float32]] = []
    heard: dict[str, tuple[PhonemeEvent, ...]] = {}

    def recognize_batch() -> None:
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
            recognize_batch()
    recognize_batch()
    return heard
