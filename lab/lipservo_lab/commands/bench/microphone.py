"""`lipservo bench microphone`: sooner or more right, so that a puppeteer can choose."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from lipservo.commands.options import Json, Model, Quiet, WeightsChoice
from lipservo.terminal.output import RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipservo_lab.commands.bench.closures import clip_phones
from lipservo_lab.commands.bench.recognition import Cache, Limit, Speakers
from lipsync.recognition.weights import DEFAULT_WEIGHTS, find_weights

if TYPE_CHECKING:
    from lipservo_lab.bench.sync.microphone_table import Recording

#: A column's heading, and the figure in it.
_COLUMNS = (
    ("look-ahead, ms", "lookahead_ms"),
    ("recogniser, ms", "latency_ms"),
    ("declared delay, ms", "declared_delay_ms"),
    ("microphone to bus, p95, ms", "microphone_to_bus_p95_ms"),
    ("P B M met", "closure_hits"),
    ("F V met", "labiodental_hits"),
    ("visemes, all", "viseme_all"),
    ("visemes, speech", "viseme_speech"),
)


def microphone(
    corpus: Annotated[
        Path | None,
        typer.Option(
            help="Folder as for `bench recognition`; without it the bundled clip, no accuracy.",
            show_default=False,
        ),
    ] = None,
    speakers: Speakers = "",
    limit: Limit = None,
    cache: Cache = None,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    model: Model = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure what look-ahead and recogniser cost and give: delay, closures, accuracy.

    From the microphone to the first goal on the bus, on a virtual clock with simulated servos.
    """
    from lipservo_lab.bench.aligned_corpus import aligned, selected
    from lipservo_lab.bench.sync.microphone_table import microphone_table
    from lipservo_lab.evaluation.recognition.benchmark import measure
    from lipservo_lab.learning.motion.trained_model import load_trained_model
    from lipsync.recognition.network_recognizer import NetworkRecognizer

    face = load_trained_model(model)
    learned = find_weights(weights)
    with progress_bar(quiet=quiet) as advance:
        if corpus is None:
            with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
                recordings: list[Recording] = [(clip, clip_phones(clip))]
                rows = microphone_table(recordings, face, weights, lambda _: {}, advance)
        else:
            utterances = selected(corpus, speakers, limit=limit)
            alignments = aligned(utterances, cache, None, advance)

            def accuracy(latency_s: float) -> Mapping[str, object]:
                found = measure(
                    utterances, alignments, lambda: NetworkRecognizer(learned, latency_s)
                ).score.figures()
                return {name: found[name] for name in ("viseme_all", "viseme_speech")}

            recordings = [(u.sound, alignments[u.name].events()) for u in utterances]
            rows = microphone_table(recordings, face, weights, accuracy, advance)
    if as_json:
        print_json({"rows": rows, "weights": weights, "machine": machine_class()})
        return
    RESULTS.print(_table(rows))


def _table(rows: list[dict[str, object]]) -> Table:
    columns = [(heading, name) for heading, name in _COLUMNS if name in rows[0]]
    table = Table(*(heading for heading, _ in columns))
    for row in rows:
        table.add_row(*(_shown(row[name]) for _, name in columns))
    return table


def _shown(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
