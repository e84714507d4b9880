"""`recognize`, `train-recognizer`, `plot-training`: what has to do with hearing phonemes."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress, TimeRemainingColumn

from lipservo.commands.options import EngineChoice, Json, Quiet, WeightsChoice
from lipservo.terminal.output import MESSAGES
from lipsync.audio.source import AudioSource
from lipsync.errors import UserError
from lipsync.extras import check_extra
from lipsync.output_file import check_output
from lipsync.recognition.weights import DEFAULT_WEIGHTS, check_weights


def recognize(
    sound: Annotated[Path | None, typer.Argument(help="Sound file.")] = None,
    mic: Annotated[
        str | None,
        typer.Option(metavar="[DEVICE]", help="Listen to a microphone.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write X.TextGrid or X.json at the end."),
    ] = None,
    engine: EngineChoice = "network",
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    as_json: Json = False,
) -> None:
    """Print the phonemes of a sound file, or of a microphone as they are spoken, with their times.

    With --json one object a line: phoneme, start_s, end_s.
    """
    if (sound is None) == (mic is None):
        raise typer.BadParameter("give a sound file or --mic")
    from lipservo.street.phone_file import check_phone_file, write_phone_file
    from lipservo.street.settled_phonemes import settled_events
    from lipservo.street.sources import DEFAULT_MICROPHONE, open_microphone
    from lipservo.street.sources import warn as warn_of_sound
    from lipsync.audio.file import FileSource

    check_weights(weights)
    if output is not None:
        check_phone_file(output, inputs=[sound])
    source: AudioSource = (
        open_microphone(mic or DEFAULT_MICROPHONE)
        if sound is None
        else FileSource(sound, warn=warn_of_sound)
    )
    events = []

    def warn(line: str) -> None:
        MESSAGES.print(line, soft_wrap=True, markup=False, highlight=False)

    try:
        for event in settled_events(source, engine, weights, warn):
            if output is not None:
                events.append(event)
            if as_json:
                record = {"phoneme": event.phoneme, "start_s": event.start_s, "end_s": event.end_s}
                sys.stdout.write(json.dumps(record) + "\n")
            elif output is None:
                sys.stdout.write(f"{event.start_s:8.2f} {event.end_s:8.2f}  {event.phoneme}\n")
            if mic is not None:
                sys.stdout.flush()
    except KeyboardInterrupt:
        MESSAGES.print("stopped")
    if output is not None:
        phones = tuple((e.phoneme, e.start_s, e.end_s or e.start_s) for e in events)
        write_phone_file(output, {"phones": phones})


def train_recognizer(
    corpora: Annotated[
        list[Path], typer.Argument(help="Folders laid out like LibriSpeech, or like grid_s1.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The weights to write.")],
    folder: Annotated[
        Path, typer.Option(help="Keeps alignments, state and run log; a run goes on from there.")
    ] = Path("recognizer-training"),
    held_out: Annotated[
        str,
        typer.Option(
            help="Speakers that train nothing, with commas between, or FILE.csv with a column "
            "`speaker`."
        ),
    ] = "",
    validation: Annotated[
        str, typer.Option(help="Speakers that only the run log hears, with commas between.")
    ] = "",
    leave_out: Annotated[
        str | None,
        typer.Option(
            metavar="FILE[:KEY]",
            help="Utterances that train nothing: a name a line, or a list in a JSON file.",
            show_default=False,
        ),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Only the first utterances of each speaker.")
    ] = None,
    synthetic: Annotated[
        str,
        typer.Option(
            metavar="VOICES",
            help="Also learn from these synthetic voices, with commas between: espeak:en-us, "
            "flite:awb, festival:ked. They read the corpora's texts.",
        ),
    ] = "",
    noise: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of sounds without speech (music, effects): noise beside speech, and "
            "silence. May be given again.",
            show_default=False,
        ),
    ] = None,
    start_from: Annotated[
        str | None,
        typer.Option(help="Weights to go on from: default, grid, or a file.", show_default=False),
    ] = None,
    start_share: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help="How much of the weights gone on from is in the mean that is written: what they "
            "knew is kept, and what is new is learned all the same.",
        ),
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="The same seed gives the same weights.")] = 0,
    steps: Annotated[int, typer.Option(min=1, help="Steps of learning.")] = 5_000,
    rate: Annotated[
        float, typer.Option(min=0.0, help="Learning rate at its peak; less to go on from weights.")
    ] = 3e-3,
    copies: Annotated[int, typer.Option(min=0, help="Disturbed copies of the speech.")] = 10,
    channels: Annotated[
        int,
        typer.Option(min=8, max=1024, help="Width of the network; what it begins as has its own."),
    ] = 192,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Processes, and threads of learning; default: one a core. With 1 the same seed "
            "gives the same bytes.",
            show_default=False,
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Learn the recogniser's weights (needs the extra `train`: torch)."""
    check_extra("torch", "train-recognizer")
    from lipsync.corpus.transcribed import read_names
    from lipsync.recognition.synthetic.synthetic_corpus import read_voices
    from lipsync.recognition.training.training_plan import TrainingPlan
    from lipsync.recognition.training.training_run import TrainingRun, run_training
    from lipsync.recognition.weights import find_weights, is_weights, save_weights

    check_output(output, replaces=is_weights, kind="weights")
    if start_share and start_from is None:
        raise UserError("--start-share is of the weights to go on from; give --start-from")
    n_jobs = jobs or os.cpu_count() or 1
    start = None if start_from is None else find_weights(start_from)
    plan = TrainingPlan(
        seed=seed, n_steps=steps, peak_rate=rate, n_threads=n_jobs, channels=channels
    )
    if start is not None:
        plan = plan.shaped_as(start)
    run = TrainingRun(
        corpora=tuple(corpora),
        folder=folder,
        held_out=_speakers(held_out),
        validation=_speakers(validation),
        left_out=frozenset() if leave_out is None else read_names(leave_out),
        limit=limit,
        voices=read_voices(synthetic) if synthetic else (),
        sounds=tuple(noise or ()),
        start=start,
        start_share=start_share,
        n_copies=copies,
        n_processes=n_jobs,
        plan=plan,
    )
    with progress_bar(quiet=quiet) as advance:
        weights = run_training(run, advance)
    save_weights(weights, output)
    MESSAGES.print(f"{output}: done; run log: {folder / 'log.jsonl'}", soft_wrap=True)


def plot_training(
    log: Annotated[Path, typer.Argument(help="The `log.jsonl` of a training's folder.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture (PNG) to write.")],
) -> None:
    """Draw the run log of `train-recognizer` (needs the extra `plots`)."""
    from lipservo.bench.training_plot import draw_log, read_log
    from lipservo.terminal.pictures import check_picture

    check_picture(output, [log])

    draw_log(read_log(log), output)
    MESSAGES.print(f"{output}: done", soft_wrap=True)


#: What is done, how many, of how many.
Advance = Callable[[str, int, int], None]


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Advance]:
    """A function (what, how many are done, of how many) that draws bars on stderr."""
    columns = (*Progress.get_default_columns()[:-1], TimeRemainingColumn())
    with Progress(*columns, console=MESSAGES, transient=True, disable=quiet) as progress:
        tasks = {}

        def advance(what: str, n_done: int, n_all: int) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=n_all)
            progress.update(tasks[what], completed=n_done, total=n_all)

        yield advance


def _speakers(listed: str) -> frozenset[str]:
    """Names with commas between; one that ends in .csv is a file of speakers."""
    from lipsync.corpus.speaker_table import read_speakers

    names: set[str] = set()
    for name in filter(None, (each.strip() for each in listed.split(","))):
        names |= set(read_speakers(Path(name))) if name.endswith(".csv") else {name}
    return frozenset(names)
