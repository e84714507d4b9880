"""How sound becomes motion: who listens, which strategy moves the mouth, and in what style."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

from lipsync.animpho.selection import STRATEGIES
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.face.model import FaceModel
from lipsync.face.synthesizer import Synthesizer
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, LiveSynthesizer, Style, StyleError
from lipsync.phonemes import LiveRecognizer
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer
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


def make_synthesizer(model: FaceModel, manner: Manner) -> Synthesizer:
    """Ours, or the paper's with one of its two selections."""
    if manner.strategy == LIVE_STRATEGY:
        return LiveSynthesizer(model, manner.style)
    return PublishedSynthesizer(model, STRATEGIES[manner.strategy])


def make_recognizer(
    engine: Engine = "network",
    timer_s: Callable[[], float] | None = None,
    weights: str = DEFAULT_WEIGHTS,
) -> FallbackRecognizer:
    """The live recogniser: the engine's, and the levels below it to fall back to.

    timer_s: a clock in seconds, to see that a level takes longer than the sound lasts; None where
    nobody waits for it.
    """
    levels = (
        FallbackLevel("network", lambda: _network(weights)),
        FallbackLevel("pocketsphinx", _pocketsphinx),
        FallbackLevel("energy", _energy),
    )
    first = [level.name for level in levels].index(engine)
    return FallbackRecognizer(levels[first:], LATENCY_S, timer_s)


def _network(weights: str) -> LiveRecognizer:
    from lipsync.recognition.network_recognizer import NetworkRecognizer

    return NetworkRecognizer(find_weights(weights), LATENCY_S)


def _pocketsphinx() -> LiveRecognizer:
    from lipsync.recognition.pocketsphinx_recognizer import PocketsphinxRecognizer

    return PocketsphinxRecognizer(_POCKETSPHINX_LATENCY_S)


def _energy() -> LiveRecognizer:
    from lipsync.recognition.energy_recognizer import EnergyRecognizer

    return EnergyRecognizer()
