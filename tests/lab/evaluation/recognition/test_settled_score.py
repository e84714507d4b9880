"""What is settled in one go is scored as the stream is."""

import numpy as np
import pytest
from lipservo_lab.corpus.alignment_cache import align_utterance
from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipservo_lab.evaluation.recognition.benchmark import measure
from lipservo_lab.evaluation.recognition.recognition_scores import settled_score
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from speech import CLIP_LABELS_PATH, CLIP_PATH

from lipsync.audio.file import read_speech
from lipsync.recognition.network import load_shipped_weights
from lipsync.recognition.network_recognizer import NetworkRecognizer


def test_it_is_what_bench_recognition_measures():
    clip = TranscribedUtterance("clip", "robot", "hello", CLIP_PATH, CLIP_LABELS_PATH)
    weights, aligned = load_shipped_weights(), align_utterance(clip)
    samples = read_speech(CLIP_PATH)
    labels = aligned.labels(len(samples) // 160)
    expected = measure([clip], {"clip": aligned}, lambda: NetworkRecognizer(weights))

    score = settled_score(weights, [LabelledSamples(samples, labels)])

    assert score.figures() == pytest.approx(expected.score.figures(), abs=0.01)
    assert np.abs(score.confusion - expected.score.confusion).sum() <= 6
