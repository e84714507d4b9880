"""`lipservo bench recognition` and `bench listening`: how well it hears, and what that costs."""

import os
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.commands.recognition import progress_bar
from lipservo.manner import Engine
from lipservo.output import MESSAGES, RESULTS, machine_class, print_json
from lipsync.phonemes import LiveRecognizer

_CORPUS = Path("../shared/corpus/librispeech")
EngineName = Annotated[Engine, typer.Option(help="Which recogniser listens.")]
Weights = Annotated[
    Path | None, typer.Option(help="Other weights than the shipped ones.", show_default=False)
]


def recognition(
    corpus: Annotated[Path, typer.Option(help="Folder laid out like LibriSpeech.")] = _CORPUS,
    speakers: Annotated[str, typer.Option(help="Only these, with commas between.")] = "",
    limit: Annotated[
        int | None, typer.Option(min=1, help="Only the first utterances of each speaker.")
    ] = None,
    latency_ms: Annotated[float, typer.Option(help="When a frame's label is due.")] = 95.0,
    engine: EngineName = "network",
    noise: Annotated[
        str | None,
        typer.Option(metavar="KIND:DB", help="white, music, babble (signal to noise), level, ..."),
    ] = None,
    cache: Annotated[
        Path | None, typer.Option(help="File of alignments, as `lipservo align` writes it.")
    ] = None,
    weights: Weights = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes that align.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure a recogniser, live, against forced alignment of the transcripts."""
    from lipsync.corpus.transcribed import of_speakers, read_transcribed
    from lipsync.recognition.alignment_cache import align_corpus
    from lipsync.recognition.benchmark import measure
    from lipsync.recognition.conditions import parse_condition

    condition = None if noise is None else parse_condition(noise)
    make = _maker(engine, latency_ms / 1e3, weights)
    chosen = frozenset(name.strip() for name in speakers.split(",") if name.strip())
    utterances = of_speakers(read_transcribed(corpus), chosen, limit)
    with progress_bar(quiet=quiet) as advance:
        counts = {"aligning": 0, "listening": 0}

        def count(what: str) -> None:
            counts[what] += 1
            advance(what, counts[what], len(utterances))

        alignments = align_corpus(
            utterances,
            cache,
            n_processes=jobs or os.cpu_count() or 1,
            progress=lambda _name: count("aligning"),
        )
        figures = measure(
            utterances, alignments, make, condition, progress=lambda _name: count("listening")
        )
    for aligned in alignments.values():
        if aligned.error:
            MESSAGES.print(f"not aligned: {aligned.name}: {aligned.error}", soft_wrap=True)
    settings = {"engine": engine, "latency_ms": latency_ms, "noise": noise}
    _print({**figures.as_dict(), **settings, "machine": machine_class()}, as_json=as_json)


def listening(
    engine: EngineName = "network",
    latency_ms: Annotated[float, typer.Option(help="When a frame's label is due.")] = 95.0,
    weights: Weights = None,
    as_json: Json = False,
) -> None:
    """Measure what is called speech where nobody speaks, and the time that a block costs."""
    import numpy as np

    from lipsync.recognition.benchmark import block_costs_s, false_speech, quiet_sounds
    from lipsync.recognition.sound import read_speech

    recognizer = _maker(engine, latency_ms / 1e3, weights)()
    figures: dict[str, object] = {
        f"false_speech_{name}": false_speech(recognizer, sound)
        for name, sound in quiet_sounds(np.random.default_rng(0)).items()
    }
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        costs_s = block_costs_s(recognizer, read_speech(clip))
    for percent in (50, 99):
        figures[f"block_ms_p{percent}_least_of_5"] = 1e3 * float(np.percentile(costs_s, percent))
    _print({**figures, "engine": engine, "machine": machine_class()}, as_json=as_json)


def _maker(engine: Engine, latency_s: float, weights: Path | None) -> Callable[[], LiveRecognizer]:
    """A function that makes the engine itself, without the ladder: a failure must be seen."""
    from lipsync.recognition.allphone import PocketsphinxRecognizer
    from lipsync.recognition.live import NetworkRecognizer
    from lipsync.recognition.weights import load_shipped_weights, load_weights

    if engine == "pocketsphinx":
        return lambda: PocketsphinxRecognizer(latency_s)
    learned = load_shipped_weights() if weights is None else load_weights(weights)
    return lambda: NetworkRecognizer(learned, latency_s)


def _print(figures: dict[str, object], *, as_json: bool) -> None:
    if as_json:
        print_json(figures)
        return
    for name, value in figures.items():
        RESULTS.print(f"{name}: {value:.4g}" if isinstance(value, float) else f"{name}: {value}")
