"""The motion of a line by ours, step by step."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.learning.motion.face_training import train
from lipservo_lab.learning.offline.offline_training import train_offline
from lipservo_lab.learning.offline.state_training import Recipe
from small_corpus import write_corpus

from lipsync.audio.file import read_speech
from lipsync.expectation.expectation import contexts, track_of
from lipsync.offline.line_methods import Line, Speaker, heard_line
from lipsync.offline.offline_model import cepstra

N_FRAMES = 30


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """Return a speaker, a line, and two functions: faces from phonemes, and from sound.

    Both functions return the faces (n, n_components) at n sound times in s.
    """
    corpus = read_grid(write_corpus(tmp_path_factory.mktemp("line") / "corpus", 8))
    model = train(corpus, n_components=3)
    offline = train_offline(corpus, model, Recipe(n_components=3, n_states=10))
    utterance = corpus.utterances[0]
    line = Line(utterance.phones, read_speech(utterance.sound_path))

    def expected(times_s):
        phonemes, known_s = contexts(track_of(line.events), times_s, 0.2)
        return model.expectation.faces(phonemes, known_s, np.full(len(times_s), 0.2))

    def told(times_s):
        return offline.sound.faces(line.events, cepstra(line.samples), times_s)

    return Speaker(model, model.expectation, offline), line, expected, told


def with_limit(speaker, limit):
    """Knowing his own voice, or not."""
    voice = replace(speaker.offline.voice, limit=limit)
    return replace(speaker, offline=replace(speaker.offline, voice=voice))


def planned(faces_at):
    """The mean of three ticks, 1 : 2 : 1, and a tenth of the last frame's step on top."""
    times_s = np.arange(N_FRAMES) / 25.0
    ticks = [faces_at(np.maximum(times_s + shift_s, 0.0)) for shift_s in (-0.01, 0.0, 0.01)]
    mean = 0.25 * ticks[0] + 0.5 * ticks[1] + 0.25 * ticks[2]
    return np.concatenate([mean[:1], mean[1:] + 0.1 * (mean[1:] - mean[:-1])])


def test_a_known_voice_is_believed_by_half(said):
    speaker, line, expected, told = said

    made = heard_line(with_limit(speaker, np.inf), line, N_FRAMES)

    both = planned(lambda times_s: (expected(times_s) + told(times_s)) / 2.0)
    np.testing.assert_allclose(made.faces, both, atol=1e-4)
    assert made.notes == ()


def test_of_another_voice_phonemes_alone_are_believed(said):
    speaker, line, expected, _ = said

    made = heard_line(with_limit(speaker, -1.0), line, N_FRAMES)

    np.testing.assert_allclose(made.faces, planned(expected), atol=1e-9)
    assert made.notes == ("unknown voice: only phonemes are used",)
