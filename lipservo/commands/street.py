"""`run`, `daemon` and `replay`: the street with one source, three clocks and ends."""

from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from firmware_bridge.clock import ManualClock, MonotonicClock
from lipservo.assembly import Manner
from lipservo.commands.options import (
    DEFAULT_FACE,
    MESSAGES,
    RESULTS,
    Config,
    Json,
    Model,
    Quiet,
    print_json,
)
from lipservo.daemon import stopped_by_signals
from lipservo.performance import Performance
from lipservo.summary import Summary, print_summary
from lipsync.animpho.live import DEFAULT_LOOKAHEAD_S, LIVE_STRATEGY, STRONGEST, Style
from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter, SilentSource
from lipsync.audio.source import AudioSource

Trace = Annotated[
    Path | None, typer.Option(help="Write every tick to this file.", show_default=False)
]
Wav = Annotated[
    Path | None,
    typer.Option(help="Sound file: WAV, FLAC, OGG, any rate.", show_default=False),
]
Mic = Annotated[
    str | None,
    typer.Option(
        help="Listen to a microphone: `default`, a number, or part of a name.", show_default=False
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        min=30.0, max=200.0, help="Frames a second; default: the face's.", show_default=False
    ),
]

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

#: Stopped by Ctrl-C: 128 + SIGINT, as shells count.
_INTERRUPTED = 130


def run(
    wav: Wav = None,
    mic: Mic = None,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    trace: Trace = None,
    rate_hz: Rate = None,
    strategy: Strategy = LIVE_STRATEGY,
    lookahead_ms: Lookahead = DEFAULT_LOOKAHEAD_S * 1e3,
    strength: Strength = 1.0,
    smoothness: Smoothness = 0.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Speech drives the face, live; without --wav or --mic the bundled clip speaks."""
    quiet = quiet or as_json
    manner = Manner(strategy, Style(lookahead_ms / 1e3, strength, smoothness))
    performance = Performance(
        config, model, trace, rate_hz, live=not quiet, quiet=quiet, manner=manner
    )
    with stopped_by_signals() as stop, _source(wav, mic) as source:
        summary = performance.play(source, MonotonicClock(), stop)
    _report(summary, as_json=as_json, quiet=quiet)
    if stop.is_set():
        MESSAGES.print("stopped; the face is at rest and limp")
        raise typer.Exit(_INTERRUPTED)


def daemon(
    wav: Wav = None,
    mic: Mic = None,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    trace: Trace = None,
    rate_hz: Rate = None,
    strategy: Strategy = LIVE_STRATEGY,
    lookahead_ms: Lookahead = DEFAULT_LOOKAHEAD_S * 1e3,
    strength: Strength = 1.0,
    smoothness: Smoothness = 0.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run until stopped; with nothing to hear the mouth rests closed. What a service starts."""
    manner = Manner(strategy, Style(lookahead_ms / 1e3, strength, smoothness))
    performance = Performance(
        config, model, trace, rate_hz, live=False, quiet=quiet, endless=True, manner=manner
    )
    idle = wav is None and mic is None
    with (
        stopped_by_signals() as stop,
        SilentSource() if idle else _source(wav, mic) as source,
    ):
        summary = performance.play(source, MonotonicClock(), stop)
    _report(summary, as_json=as_json, quiet=quiet)


def replay(
    sound: Annotated[Path, typer.Argument(help="Sound file to replay.")],
    config: Config = DEFAULT_FACE,
    model: Model = None,
    trace: Trace = None,
    rate_hz: Rate = None,
    strategy: Strategy = LIVE_STRATEGY,
    lookahead_ms: Lookahead = DEFAULT_LOOKAHEAD_S * 1e3,
    strength: Strength = 1.0,
    smoothness: Smoothness = 0.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run the street as fast as it goes, on a clock of its own: same file, same trace."""
    manner = Manner(strategy, Style(lookahead_ms / 1e3, strength, smoothness))
    performance = Performance(config, model, trace, rate_hz, live=False, quiet=True, manner=manner)
    with stopped_by_signals() as stop, _source(sound, None) as source:
        summary = performance.play(source, ManualClock(), stop)
    _report(summary, as_json=as_json, quiet=quiet)
    if stop.is_set():
        raise typer.Exit(_INTERRUPTED)


def _source(wav: Path | None, mic: str | None) -> AudioSource:
    """The file, the microphone, or the bundled clip."""
    if wav is not None and mic is not None:
        raise typer.BadParameter("give --wav or --mic, not both")
    if mic is not None:
        from lipsync.audio.microphone import MicrophoneSource

        named = None if mic == "default" else int(mic) if mic.isdigit() else mic
        return MicrophoneSource(named)
    if wav is not None:
        return SilenceAfter(FileSource(wav))
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        return SilenceAfter(FileSource(clip))


def _report(summary: Summary, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        print_json(summary.as_dict())
    elif not quiet:
        print_summary(summary, RESULTS)
