"""`align`, `recognize` and `train-recognizer`: what has to do with hearing phonemes."""

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
from lipservo.output import MESSAGES, RESULTS, print_json
from lipsync.extras import check_extra
from lipsync.output_file import check_output
from lipsync.recognition.weights import DEFAULT_WEIGHTS, check_weights_name

Jobs = Annotated[
    int | None,
    typer.Option(min=1, help="Processes; default: one a core.", show_default=False),
]


def align(
    sound: Annotated[Path, typer.Argument(help="Sound file, or folder laid out like LibriSpeech.")],
    text: Annotated[
        str | None, typer.Argument(help="What is said, or a text file that holds it.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="TextGrid to write; of a folder: JSON lines."),
    ] = None,
    jobs: Jobs = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find when each phone of a known text is spoken; of a folder, all its transcripts."""
    if sound.is_dir():
        _align_corpus(sound, output, jobs or os.cpu_count() or 1, as_json=as_json, quiet=quiet)
        return
    if text is None:
        raise typer.BadParameter("say what is said in the sound", param_hint="TEXT")
    from lipsync.recognition.alignment import align as force_align
    from lipsync.recognition.sound import read_speech
    from lipsync.textgrid import is_textgrid, write_tiers

    if output is not None:
        check_output(output, replaces=is_textgrid, kind="TextGrid", inputs=[sound])
    said = Path(text).read_text(encoding="utf-8") if _is_file(text) else text
    alignment = force_align(read_speech(sound), said)
    phones = tuple((e.phoneme, e.start_s, e.end_s or e.start_s) for e in alignment.phones)
    if alignment.beams != "default":
        MESSAGES.print("found only with tight beams: no yardstick for accuracy")
    if alignment.guessed:
        MESSAGES.print(f"pronunciation guessed: {', '.join(alignment.guessed)}")
    if output is not None:
        write_tiers(output, {"words": alignment.words, "phones": phones})
    if as_json:
        print_json(
            {
                "phones": phones,
                "words": alignment.words,
                "beams": alignment.beams,
                "guessed": alignment.guessed,
            }
        )
    elif output is None:
        for phoneme, start_s, end_s in phones:
            RESULTS.print(f"{start_s:8.2f} {end_s:8.2f}  {phoneme}")


def recognize(
    sound: Annotated[Path | None, typer.Argument(help="Sound file.")] = None,
    mic: Annotated[
        str | None,
        typer.Option(metavar="[DEVICE]", help="Listen to a microphone.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="TextGrid to write at the end.")
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
    from lipservo.listening import heard_events
    from lipservo.sources import DEFAULT_MICROPHONE, open_microphone
    from lipsync.audio.file import FileSource
    from lipsync.textgrid import is_textgrid, write_tiers

    check_weights_name(weights)
    if output is not None:
        check_output(output, replaces=is_textgrid, kind="TextGrid", inputs=[sound])
    source = FileSource(sound) if sound is not None else open_microphone(mic or DEFAULT_MICROPHONE)
    events = []

    def warn(reason: str) -> None:
        MESSAGES.print(f"recogniser left: {reason}", soft_wrap=True)

    try:
        for event in heard_events(source, engine, weights, warn):
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
        write_tiers(output, {"phones": phones})


def train_recognizer(
    corpora: Annotated[
        list[Path], typer.Argument(help="Folders laid out like LibriSpeech, or like grid_s1.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The weights to write.")],
    folder: Annotated[
        Path, typer.Option(help="Keeps alignments, state and run log; a run goes on from there.")
    ] = Path("recognizer-training"),
    held_out: Annotated[
        str, typer.Option(help="Speakers that train nothing, with commas between.")
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
    start_from: Annotated[
        str | None,
        typer.Option(help="Weights to go on from: default, grid, or a file.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same weights.")] = 0,
    steps: Annotated[int, typer.Option(min=1, help="Steps of learning.")] = 5_000,
    rate: Annotated[
        float, typer.Option(min=0.0, help="Learning rate at its peak; less to go on from weights.")
    ] = 3e-3,
    copies: Annotated[int, typer.Option(min=0, help="Disturbed copies of the speech.")] = 10,
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
    from lipsync.recognition.training import TrainingPlan
    from lipsync.recognition.training_run import TrainingRun, run_training
    from lipsync.recognition.weights import find_weights, is_weights, save_weights

    check_output(output, replaces=is_weights, kind="weights")
    n_jobs = jobs or os.cpu_count() or 1
    run = TrainingRun(
        corpora=tuple(corpora),
        folder=folder,
        held_out=_names(held_out),
        validation=_names(validation),
        left_out=frozenset() if leave_out is None else read_names(leave_out),
        start=None if start_from is None else find_weights(start_from),
        n_copies=copies,
        n_processes=n_jobs,
        plan=TrainingPlan(seed=seed, n_steps=steps, peak_rate=rate, n_threads=n_jobs),
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
    from lipservo.pictures import check_picture
    from lipservo.training_plot import draw_log, read_log

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


def _align_corpus(
    folder: Path, output: Path | None, n_processes: int, *, as_json: bool, quiet: bool
) -> None:
    from lipsync.corpus.transcribed import read_transcribed
    from lipsync.recognition.alignment_cache import align_corpus

    if output is None:
        raise typer.BadParameter("name the file for the alignments", param_hint="--output")
    utterances = read_transcribed(folder)
    with progress_bar(quiet=quiet) as advance:
        done: list[str] = []

        def count(name: str) -> None:
            done.append(name)
            advance("aligning", len(done), len(utterances))

        aligned = align_corpus(utterances, output, n_processes=n_processes, progress=count)
    failed = {a.name: a.error for a in aligned.values() if a.error}
    tight = sum(a.beams == "tight" for a in aligned.values())
    if as_json:
        print_json({"utterances": len(aligned), "tight": tight, "failed": failed})
        return
    for name, error in failed.items():
        MESSAGES.print(f"not aligned: {name}: {error}", soft_wrap=True)
    RESULTS.print(
        f"{output}: {len(aligned) - len(failed)} of {len(aligned)} utterances aligned, "
        f"{tight} of them only with tight beams",
        soft_wrap=True,
    )


def _is_file(text: str) -> bool:
    try:
        return Path(text).is_file()
    except OSError:  # a text too long for a file's name
        return False


def _names(listed: str) -> frozenset[str]:
    return frozenset(name.strip() for name in listed.split(",") if name.strip())
