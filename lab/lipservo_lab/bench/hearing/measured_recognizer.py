"""Recognisers as they are measured: one alone, without the ladder, as a failure must be seen."""

from collections.abc import Callable

from lipservo.settings.motion_names import MeasuredEngine
from lipsync.extras import check_extra
from lipsync.phonemes import LiveRecognizer
from lipsync.recognition.energy_recognizer import EnergyRecognizer
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.weights import DEFAULT_WEIGHTS, find_weights


def measured_recognizer(
    engine: MeasuredEngine, latency_s: float, weights: str = DEFAULT_WEIGHTS
) -> Callable[[], LiveRecognizer]:
    """A function that makes the engine itself.

    `energy` has a latency of its own. Raises MissingExtraError for pocketsphinx where it is not
    installed, WeightsError.
    """
    if engine == "pocketsphinx":
        check_extra("pocketsphinx", "comparing with pocketsphinx")
        from lipservo_lab.evaluation.recognition.pocketsphinx_recognizer import (
            PocketsphinxRecognizer,
        )

        return lambda: PocketsphinxRecognizer(latency_s)
    if engine == "energy":
        return EnergyRecognizer
    learned = find_weights(weights)
    return lambda: NetworkRecognizer(learned, latency_s)
