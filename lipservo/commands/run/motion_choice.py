"""The command-line options for how sound becomes motion, shared by all commands that have them."""

import functools
import inspect
from collections.abc import Callable
from typing import Any

from lipservo.commands.options import (
    FaceEngine,
    FaceStrategy,
    FaceWeights,
    Lookahead,
    LowLatency,
    Smoothness,
    Strength,
    UnitShare,
)
from lipservo.runtime.motion_options import ChosenMotion


def chosen_motion(
    engine: FaceEngine = None,
    weights: FaceWeights = None,
    strategy: FaceStrategy = None,
    lookahead_ms: Lookahead = None,
    strength: Strength = None,
    smoothness: Smoothness = None,
    unit_share: UnitShare = None,
    low_latency: LowLatency = False,
) -> ChosenMotion:
    """Return the options for how sound becomes motion that the user gave; None: not given."""
    style = (lookahead_ms, strength, smoothness, unit_share)
    return ChosenMotion(engine, weights, strategy, *style, low_latency)


def takes_motion(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with its parameter `motion` replaced by the options of `chosen_motion`.

    Typer reads a command's options off its signature and knows no groups of them.
    """
    options = inspect.signature(chosen_motion).parameters

    @functools.wraps(command)
    def with_options(**given: Any) -> None:
        motion = chosen_motion(**{name: given.pop(name) for name in options})
        command(**given, motion=motion)

    # The signature that typer reads: `motion` gives way to the options, all by keyword.
    merged: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        merged += options.values() if parameter.name == "motion" else [parameter]
    merged = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in merged]
    with_options.__signature__ = inspect.Signature(merged)  # type: ignore[attr-defined]
    with_options.__annotations__ = {parameter.name: parameter.annotation for parameter in merged}
    return with_options
