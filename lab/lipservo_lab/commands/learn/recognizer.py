"""`learn recognizer` and `learn plot`: the recogniser's weights, and the log of their training."""

import os
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Quiet
from lipservo.terminal.output import MESSAGES
from lipservo.terminal.progress_bar import progress_bar
from lipsync.errors import UserError
from lipsync.extras import check_extra
from lipsync.output_file import check_output


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
    check_extra("torch", "learn recognizer")
    from lipservo_lab.corpus.transcribed import read_names
    from lipservo_lab.learning.recognition.training_plan import TrainingPlan
    from lipservo_lab.learning.recognition.training_run import TrainingRun, run_training
    from lipservo_lab.learning.synthetic.synthetic_corpus import read_voices
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
    from lipservo.terminal.pictures import check_picture
    from lipservo_lab.bench.training_plot import draw_log, read_log

    check_picture(output, [log])

    draw_log(read_log(log), output)
    MESSAGES.print(f"{output}: done", soft_wrap=True)


def _speakers(listed: str) -> frozenset[str]:
    """Names with commas between; one that ends in .csv is a file of speakers."""
    from lipservo_lab.corpus.speaker_table import read_speakers

    names: set[str] = set()
    for name in filter(None, (each.strip() for each in listed.split(","))):
        names |= set(read_speakers(Path(name))) if name.endswith(".csv") else {name}
    return frozenset(names)
