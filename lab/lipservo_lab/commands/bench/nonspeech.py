"""`lipservo bench nonspeech`: how long the mouth opens for sounds that are no speech."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from lipservo.commands.options import EngineChoice, Json, Model, Quiet, WeightsChoice
from lipservo.terminal.output import MESSAGES, RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipsync.errors import UserError
from lipsync.motion.live_synthesizer import DEFAULT_LOOKAHEAD_S
from lipsync.recognition.weights import DEFAULT_WEIGHTS, check_weights


def nonspeech(
    folder: Annotated[
        Path, typer.Argument(help="Sound files in which nobody speaks, in it and below it.")
    ],
    engine: EngineChoice = "network",
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    model: Model = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how often, how long and how wide the mouth opens while nobody speaks.

    Through recogniser and default motion as they run live. A folder below FOLDER is a kind of
    sound, and has its own line. Files that are no sound are named and left out.
    """
    from lipservo.street.motion_options import make_recognizer
    from lipservo_lab.bench.hearing.nonspeech_folder import nonspeech_folder, sound_files
    from lipservo_lab.learning.motion.trained_model import load_trained_model

    check_weights(weights)
    files = sound_files(folder)
    recognizer = make_recognizer(engine, weights=weights)
    with progress_bar(quiet=quiet) as advance:
        found = nonspeech_folder(
            folder,
            files,
            recognizer,
            load_trained_model(model),
            DEFAULT_LOOKAHEAD_S,
            lambda n: advance("listening", n, len(files)),
        )
    for line in found.not_sound:
        MESSAGES.print(f"left out: {line}", soft_wrap=True)
    if recognizer.reasons:
        raise UserError(f"the recogniser was left: {'; '.join(recognizer.reasons)}")
    settings = {
        "engine": engine,
        "weights": weights,
        "lookahead_ms": DEFAULT_LOOKAHEAD_S * 1e3,
        "machine": machine_class(),
    }
    figures = found.as_dict()
    if as_json:
        print_json({**figures, **settings})
        return
    table = Table("folder", "open", "speech", "openings/min", "widest mm", "files", "s")
    for name, row in {"all": found.figures(), **found.figures_by_folder()}.items():
        table.add_row(
            name,
            *(f"{row[key]:.3f}" for key in ("open_share", "speech_share")),
            *(f"{round(row[key], 1) + 0.0:.1f}" for key in ("openings_per_min", "widest_mm")),
            *(f"{row[key]:.0f}" for key in ("files", "seconds")),
        )
    RESULTS.print(table)
