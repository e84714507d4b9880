"""What is recorded of a recogniser's stream: frame labels, updates, processor time."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.alignment_cache import PHONEME_INDEX
from lipsync.arrays import Array, Array32
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock
from lipsync.phonemes import (
    PHONEMES,
    SILENCE,
    VISEME_OF,
    LiveRecognizer,
    PhonemeUpdate,
    ServoListener,
)
from lipsync.recognition.network_recognizer import FOLLOWING_LATENCY_S
from lipsync.recognition.own_noise import ServoSpeeds
from lipsync.recognition.streaming import RecognizerStream, StreamStep, blocks_of
from lipsync.recognition.text_decoder import TextFollower
from lipsync.text_to_speech.pronunciation import pronounced
from lipsync.timeline import PhonemeTimeline

Labels = NDArray[np.int64]

_HOP = round(BLOCK_S * SAMPLE_RATE_HZ)
_CLASS_OF = np.array([VISEME_OF[phoneme] for phoneme in PHONEMES])
_UNKNOWN = -1


class FrameLabels:
    """The newest phoneme index of each 10 ms frame, and how often a frame's viseme class changed.

    labels: (n_frames,). n_revisions: number of changes.
    """

    def __init__(self, n_frames: int) -> None:
        self.labels: Labels = np.full(n_frames, PHONEME_INDEX[SILENCE])
        self.n_revisions = 0
        self._visemes = np.full(n_frames, _UNKNOWN)

    def observe(self, step: StreamStep) -> None:
        """Apply the updates of one step."""
        for update in step.updates:
            self._apply(update)

    def _apply(self, update: PhonemeUpdate) -> None:
        """Write an update's events over the frame labels; count frames whose viseme class changed.

        A frame's first label is not a change.
        """
        for event in update.events:
            first = round(max(event.start_s, update.replace_from_s) / BLOCK_S)
            end_s = update.heard_until_s if event.end_s is None else event.end_s
            frames = slice(first, round(end_s / BLOCK_S))
            viseme = _CLASS_OF[PHONEME_INDEX[event.phoneme]]
            visemes = self._visemes[frames]
            self.n_revisions += int(np.count_nonzero((visemes != _UNKNOWN) & (visemes != viseme)))
            visemes[:] = viseme
            self.labels[frames] = PHONEME_INDEX[event.phoneme]


class StepCosts:
    """Processor time of each step, s."""

    def __init__(self) -> None:
        self.costs_s: list[float] = []

    def observe(self, step: StreamStep) -> None:
        """Note the processor time of one step."""
        self.costs_s.append(step.cost_s)


class UpdateLog:
    """All updates in order, and the timeline that they result in."""

    def __init__(self) -> None:
        self.updates: list[PhonemeUpdate] = []
        self.timeline = PhonemeTimeline(horizon_s=math.inf)

    def observe(self, step: StreamStep) -> None:
        """Apply and store the updates of one step."""
        for update in step.updates:
            self.timeline.apply(update)
            self.updates.append(update)


def label_frames(
    recognizer: LiveRecognizer,
    samples: Array32,
    servos_deg: Array | None = None,
    text: str = "",
) -> tuple[FrameLabels, StepCosts]:
    """Run a recogniser on samples as a live stream, and on silence until all labels are final.

    The blocks are 10 ms long and end when the label of a frame is due, latency_s after the start of
    the frame. So frame t gets the label that was final when the sound up to 10 t ms + latency had
    come. The costs are those of the blocks.

    Parameters
    ----------
    recognizer : LiveRecognizer
        Is reset first.
    samples : Array32
        (n,) at 16 kHz.
    servos_deg : Array | None
        (n_frames, n_servos), encoder readings every 10 ms, of which the recogniser gets the speeds;
        None: it gets none.
    text : str
        Words that the recogniser gets beforehand, if it can follow a text; empty: none.

    Returns
    -------
    tuple[FrameLabels, StepCosts]
        Labels, and processor time of each block in s.
    """
    recognizer.reset()
    n_tail = round((recognizer.latency_s + 0.1) * SAMPLE_RATE_HZ)
    padded = np.concatenate((samples, np.zeros(n_tail, np.float32)))
    n_first = round(recognizer.latency_s * SAMPLE_RATE_HZ) % _HOP or _HOP
    labels, costs = FrameLabels(len(samples) // _HOP), StepCosts()
    whole_blocks = padded[: n_first + (len(padded) - n_first - 1) // _HOP * _HOP]
    blocks = blocks_of(whole_blocks, n_first)
    if servos_deg is not None and isinstance(recognizer, ServoListener):
        blocks = _with_servos(blocks, recognizer, servos_deg)
    if text and isinstance(recognizer, TextFollower):
        recognizer.tell(pronounced(text))
    RecognizerStream(recognizer, (labels, costs)).run(blocks)
    return labels, costs


@dataclass(frozen=True, slots=True)
class Leaving:
    """When a known text that is no longer spoken stopped moving the mouth.

    left_s: s after the departure; None: it moved the mouth to the end of the sound.
    """

    left_s: float | None


def time_to_leave(
    recognizer: LiveRecognizer, speech: Array32, other: Array32, onset_s: float, text: str
) -> Leaving:
    """Play speech with its text, then another sound that departs from the text.

    Parameters
    ----------
    recognizer : LiveRecognizer
        Follows a text; reset first.
    speech : Array32
        (n,), whose words begin the text.
    other : Array32
        (m,), played after it.
    onset_s : float
        Time of the first phone in the other sound.
    text : str
        The words that the recogniser gets beforehand.

    Returns
    -------
    Leaving
        Seconds from that phone until the text no longer moves the mouth.
    """
    recognizer.reset()
    assert isinstance(recognizer, TextFollower)
    recognizer.tell(pronounced(text))
    samples = np.concatenate((speech, other))
    onset_s += len(speech) / SAMPLE_RATE_HZ
    stream = RecognizerStream(recognizer)
    for block in blocks_of(samples[: len(samples) // _HOP * _HOP], _HOP):
        stream.feed([block])
        frame_s = block.end_s - FOLLOWING_LATENCY_S
        if frame_s >= onset_s and recognizer.moved_by == "sound":
            return Leaving(frame_s - onset_s)
    return Leaving(None)


def _with_servos(
    blocks: Iterable[AudioBlock], recognizer: ServoListener, servos_deg: Array
) -> Iterator[AudioBlock]:
    """Yield the blocks; before each, the recogniser gets the servo speeds until its end."""
    speeds, n_read = ServoSpeeds(), 0
    for block in blocks:
        while n_read < len(servos_deg) and (n_read + 1) * BLOCK_S <= block.end_s:
            found = speeds.take((n_read + 1) * BLOCK_S, servos_deg[n_read])
            if found is not None:
                recognizer.note_servo_speeds(*found)
            n_read += 1
        yield block
