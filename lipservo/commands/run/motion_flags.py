"""The options that say how sound becomes motion, declared once for all commands that take them."""

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from lipservo.commands.run.recognizer_options import EngineChoice, WeightsChoice
from lipservo.street.motion_options import Manner
from lipsync.motion.live_synthesizer import DEFAULT_LOOKAHEAD_S, LIVE_STRATEGY, STRONGEST, Style
from lipsync.recognition.weights import DEFAULT_WEIGHTS

Strategy = Annotated[
    str, typer.Option(help="How phonemes become motion: expected, or the paper's naive, priority.")
]
Lookahead = Annotated[
    float,
    typer.Option(min=0.0, max=1000.0, help="Show the face so much later, for what comes next."),
]
Strength = Annotated[
    float, typer.Option(min=0.0, max=STRONGEST, help="How far the mouth moves; 1 as the talker.")
]
Smoothness = Annotated[float, typer.Option(min=0.0, max=1.0, help="0 crisp, 1 slow.")]


def chosen_manner(
    engine: EngineChoice = "network",
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    strategy: Strategy = LIVE_STRATEGY,
    lookahead_ms: Lookahead = DEFAULT_LOOKAHEAD_S * 1e3,
    strength: Strength = 1.0,
    smoothness: Smoothness = 0.0,
) -> Manner:
    """The manner these options ask for."""
    return Manner(engine, weights, strategy, Style(lookahead_ms / 1e3, strength, smoothness))


def manner_arguments(manner: Manner) -> list[str]:
    """The command line that gives this manner: what `chosen_manner` reads, for another process."""
    style = manner.style
    return [
        *("--engine", manner.engine),
        *("--weights", manner.weights),
        *("--strategy", manner.strategy),
        *("--lookahead-ms", str(style.lookahead_s * 1e3)),
        *("--strength", str(style.strength)),
        *("--smoothness", str(style.smoothness)),
    ]


def takes_manner(command: Callable[..., None]) -> Callable[..., None]:
    """The command with its parameter `manner` replaced by the options of `chosen_manner`.

    Typer reads a command's options off its signature and knows no groups of them.
    """
    options = inspect.signature(chosen_manner).parameters

    @functools.wraps(command)
    def with_options(**given: Any) -> None:
        manner = chosen_manner(**{name: given.pop(name) for name in options})
        command(**given, manner=manner)

    shown: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        shown += options.values() if parameter.name == "manner" else [parameter]
    shown = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in shown]
    with_options.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
    with_options.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
    return with_options
