"""Live recognisers by name, each with the ladder of recognisers that replace it if it fails."""

from collections.abc import Callable
from functools import partial

from lipsync.phonemes import RecognizerKind
from lipsync.plugins import DEFAULT_RECOGNIZER, RECOGNIZERS, PluginError
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer
from lipsync.recognition.network import DEFAULT_WEIGHTS, LATENCY_S


def recognizer_kind(name: str) -> RecognizerKind:
    """Return the recogniser kind registered as `name`. Raises PluginError if there is none."""
    kind = RECOGNIZERS.load(name)
    if not isinstance(kind, RecognizerKind):
        raise PluginError(f"recogniser {name}: the package of this name is no recogniser")
    return kind


def make_recognizer(
    engine: str = DEFAULT_RECOGNIZER,
    timer_s: Callable[[], float] | None = None,
    weights: str = DEFAULT_WEIGHTS,
    latency_s: float = LATENCY_S,
) -> FallbackRecognizer:
    """Return a live recogniser that falls back from `engine` to the built-in recognisers below it.

    A recogniser of another package falls back to all built-in ones. timer_s: a clock in seconds, by
    which a recogniser that is slower than its sound is replaced and better ones are tried again;
    None in offline use. weights: name of shipped weights, or path of a file. latency_s: in seconds,
    raised to what the slowest recogniser needs. Raises PluginError if `engine` is unknown or cannot
    be loaded.
    """
    ours = list(RECOGNIZERS.built_in)
    names = ours[ours.index(engine) :] if engine in ours else [engine, *ours]
    kinds = {name: recognizer_kind(name) for name in names}
    levels = [
        FallbackLevel(name, partial(kind.make, weights, latency_s)) for name, kind in kinds.items()
    ]
    longest_s = max([latency_s, *(kind.latency_s for kind in kinds.values())])
    return FallbackRecognizer(levels, longest_s, timer_s)


def no_recognizer() -> FallbackRecognizer:
    """Return a recogniser that reports only silence, for phonemes all known beforehand."""
    return FallbackRecognizer((), 0.0)
