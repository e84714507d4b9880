"""How sound becomes motion: who listens, which strategy moves the mouth, and in what style."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from lipsync.animpho.selection import STRATEGIES
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.animpho.units import read_animphos
from lipsync.expectation.expectation_file import read_expectation
from lipsync.face.model import FaceModel, read_face
from lipsync.face.model_file import ModelError, open_model
from lipsync.face.synthesizer import Synthesizer
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, LiveSynthesizer, Style, StyleError
from lipsync.phonemes import LiveRecognizer
from lipsync.recognition.fallback import RecognizerLadder, Rung
from lipsync.recognition.weights import DEFAULT_WEIGHTS, check_weights, find_weights

#: Which recogniser is tried first.
Engine = Literal["network", "pocketsphinx"]
#: All of them, the default first.
ENGINES: tuple[Engine, ...] = get_args(Engine)
#: The recogniser's share of the delay: the network's committing head (docs/recognition.md).
LATENCY_S = 0.095
_POCKETSPHINX_LATENCY_S = 0.09


@dataclass(frozen=True, slots=True)
class Manner:
    """The recogniser to begin with, the strategy by name, and the style of ours.

    weights: shipped ones by name, or a file; read and refused here, as a live face would fall back
    to a lesser recogniser. Raises WeightsError, StyleError.
    """

    engine: Engine = "network"
    weights: str = DEFAULT_WEIGHTS
    strategy: str = LIVE_STRATEGY
    style: Style = field(default_factory=Style)

    def __post_init__(self) -> None:
        check_weights(self.weights)
        known = (LIVE_STRATEGY, *STRATEGIES)
        if self.strategy not in known:
            raise StyleError(f"unknown strategy {self.strategy!r}; known here: {', '.join(known)}")


def make_synthesizer(
    face: FaceModel, manner: Manner, model_path: Path | None = None
) -> Synthesizer:
    """Ours, or the paper's with one of its two selections.

    model_path: the file that the face came from, None for the shipped one; of it is read only what
    the strategy plays. Raises ModelError.
    """
    with open_model(model_path) as file:
        if read_face(file).checksum != face.checksum:
            raise ModelError(f"{file.name}: has changed while it was being read; start again")
        if manner.strategy == LIVE_STRATEGY:
            expectation = read_expectation(file, face.n_components)
            return LiveSynthesizer(face, expectation, manner.style)
        return PublishedSynthesizer(read_animphos(file, face), STRATEGIES[manner.strategy])


def make_recognizer(
    engine: Engine = "network",
    timer_s: Callable[[], float] | None = None,
    weights: str = DEFAULT_WEIGHTS,
) -> RecognizerLadder:
    """The live recogniser, from the engine's rung of the ladder down.

    timer_s: a clock in seconds, to see that a rung takes longer than the sound lasts; None where
    nobody waits for it.
    """
    rungs = (
        Rung("network", lambda: _network(weights)),
        Rung("pocketsphinx", _pocketsphinx),
        Rung("loudness", _loudness),
    )
    first = [rung.name for rung in rungs].index(engine)
    return RecognizerLadder(rungs[first:], LATENCY_S, timer_s)


def _network(weights: str) -> LiveRecognizer:
    from lipsync.recognition.network_recognizer import NetworkRecognizer

    return NetworkRecognizer(find_weights(weights), LATENCY_S)


def _pocketsphinx() -> LiveRecognizer:
    from lipsync.recognition.allphone_recognizer import PocketsphinxRecognizer

    return PocketsphinxRecognizer(_POCKETSPHINX_LATENCY_S)


def _loudness() -> LiveRecognizer:
    from lipsync.recognition.loudness_recognizer import LoudnessRecognizer

    return LoudnessRecognizer()
