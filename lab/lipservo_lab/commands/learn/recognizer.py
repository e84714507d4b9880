"""`learn recognizer` trains weights of the recogniser; `learn adapt` adapts them to one voice.

`learn plot` draws the log of a training: the loss, and the accuracy on the validation speakers.
"""

import json
import os
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from lipservo.commands.options import Json, Quiet, WeightsChoice
from lipservo.terminal.output import MESSAGES, RESULTS, print_json, progress_bar
from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.commands.options import Jobs, Limit, Seed, WeightsOutput
from lipsync.errors import UserError, check_extra, check_inputs
from lipsync.output_file import check_output
from lipsync.recognition.network import DEFAULT_WEIGHTS

if TYPE_CHECKING:
    from lipservo_lab.learning.adaptation.voice import Voice


def train_recognizer(
    corpora: Annotated[
        list[Path],
        typer.Argument(help="Folders of recordings with texts (docs/recognition.md, Corpora)."),
    ],
    output: WeightsOutput,
    folder: Annotated[
        Path, typer.Option(help="Folder that keeps alignments, state and log of the run.")
    ] = Path("recognizer-training"),
    held_out: Annotated[
        str,
        typer.Option(
            help="Speakers not to train on, commas between, or FILE.csv with a column `speaker`."
        ),
    ] = "",
    validation: Annotated[
        str, typer.Option(help="Speakers not to train on, who grade the training, commas between.")
    ] = "",
    leave_out: Annotated[
        str | None,
        typer.Option(
            metavar="FILE[:KEY]",
            help="Utterances not to train on: a file of names, one a line, or FILE.json:KEY.",
        ),
    ] = None,
    limit: Limit = None,
    synthetic: Annotated[
        str,
        typer.Option(
            metavar="VOICES",
            help="Synthetic voices that read the corpora's texts, to learn from too, such as "
            "espeak:en-us,flite:awb,festival:ked.",
        ),
    ] = "",
    noise: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of sounds without speech (music, effects), used as noise behind speech "
            "and as silence; may be repeated."
        ),
    ] = None,
    start_from: Annotated[
        str | None, typer.Option(help="Weights to start from: default, grid, or a weights file.")
    ] = None,
    start_share: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Share of --start-from in the weights written, an average of these and the "
            "learned ones.",
        ),
    ] = 0.0,
    seed: Seed = 0,
    steps: Annotated[int, typer.Option(min=1, help="Number of training steps.")] = 5_000,
    rate: Annotated[
        float, typer.Option(min=0.0, help="Peak learning rate; give less with --start-from.")
    ] = 3e-3,
    copies: Annotated[int, typer.Option(min=0, help="Noisy copies of each recording to use.")] = 10,
    delays: Annotated[
        str,
        typer.Option(
            metavar="N,N,...",
            help="Delays at which the network puts phonemes out, frames of 10 ms; default: "
            "2,7,12. A network that will be a --teacher may wait longer, such as 60.",
            show_default=False,
        ),
    ] = "",
    teacher: Annotated[
        str | None,
        typer.Option(
            metavar="WEIGHTS",
            help="Weights of a teacher network: it aligns the labels anew, its probabilities are "
            "targets too, and texts that it does not find in the sound are left out.",
        ),
    ] = None,
    visible_weight: Annotated[
        float, typer.Option(min=0.0, help="Weight in the loss of each mm of visible error.")
    ] = 0.0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the run in --folder, if there is one.")
    ] = False,
    jobs: Jobs = None,
    quiet: Quiet = False,
) -> None:
    """Train the recogniser's network on recordings with texts (needs the extra `train`: torch).

    With --jobs 1 the same seed gives the same bytes. --start-from grid: the default weights,
    trained further on one speaker of GRID. --visible-weight: visible error is the distance in mm
    between the lips of the phonemes found and of those said.
    """
    check_inputs(*corpora)
    check_extra("torch", "learn recognizer")
    from lipservo_lab.corpus.transcribed import read_names
    from lipservo_lab.learning.recognition.synthetic_corpus import read_voices
    from lipservo_lab.learning.recognition.training_data import TrainingPlan
    from lipservo_lab.learning.recognition.training_run import TrainingRun, run_training
    from lipsync.recognition.network import find_weights, is_weights, save_weights

    check_output(output, replaces=is_weights, kind="weights")
    if start_share and start_from is None:
        raise UserError("--start-share needs weights to start from; give --start-from")
    n_jobs = jobs or os.cpu_count() or 1
    start = None if start_from is None else find_weights(start_from)
    plan = TrainingPlan(
        seed=seed,
        n_steps=steps,
        peak_rate=rate,
        n_threads=n_jobs,
        visible_weight=visible_weight,
    )
    if start is not None:
        plan = plan.shaped_as(start)
    plan = plan.with_delays(_delays(delays) or plan.delays)
    if start is not None and start_share and plan.delays != start.delays:
        raise UserError("leave out --start-share or --delays")
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
        teacher=None if teacher is None else find_weights(teacher),
        resumes=resume,
        n_copies=copies,
        n_processes=n_jobs,
        plan=plan,
    )
    with progress_bar(quiet=quiet) as advance:
        weights = run_training(run, advance)
    save_weights(weights, output)
    MESSAGES.print(f"{output}: done; run log: {folder / 'log.jsonl'}", soft_wrap=True)


def _delays(listed: str) -> tuple[int, ...]:
    """Return the delays in a list with commas, which may be empty. Raises UserError."""
    listed_texts = filter(None, map(str.strip, listed.split(",")))
    numbers = [int(text) if text.isdecimal() else -1 for text in listed_texts]
    if not all(0 <= number <= 200 for number in numbers):
        raise UserError(f"--delays {listed}: give numbers from 0 to 200, like 2,7,12")
    return tuple(numbers)


def plot_training(
    log: Annotated[Path, typer.Argument(help="File log.jsonl in the --folder of a training.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Picture to write, .png.")],
) -> None:
    """Draw losses and accuracies of a run of `learn recognizer` (needs the extra `plots`)."""
    from lipservo.terminal.pictures import check_picture

    check_picture(output, [log])

    draw_log(read_log(log), output)
    MESSAGES.print(f"{output}: done", soft_wrap=True)


def _speakers(listed: str) -> frozenset[str]:
    """Return names with commas between; a name that ends in .csv is a file of speakers."""
    from lipservo_lab.corpus.transcribed import read_speakers

    names: set[str] = set()
    for name in filter(None, (entry.strip() for entry in listed.split(","))):
        names |= set(read_speakers(Path(name))) if name.endswith(".csv") else {name}
    return frozenset(names)


#: Figures that grade an adaptation, with their labels in the table.
_GRADED = {
    "viseme_speech": "visemes, frames of speech",
    "viseme_all": "visemes, all frames",
    "closure_recall": "P B M heard",
    "closure_precision": "of those heard, said",
    "per": "phone error rate",
}


def adapt(
    voice_folder: Annotated[
        Path,
        typer.Argument(
            help="Folder of 2 to 10 minutes of one voice: NAME.wav and its text NAME.txt; or "
            "recordings with texts (docs/recognition.md, Corpora)."
        ),
    ],
    output: WeightsOutput,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    speaker: Annotated[
        str | None, typer.Option(help="Speaker to use, in recordings of several speakers.")
    ] = None,
    seed: Seed = 0,
    steps: Annotated[int, typer.Option(min=1, help="Number of training steps.")] = 100,
    rate: Annotated[float, typer.Option(min=0.0, max=0.01, help="Peak learning rate.")] = 5e-4,
    copies: Annotated[
        int, typer.Option(min=0, help="Copies of each sentence to train on, with added noise.")
    ] = 2,
    jobs: Jobs = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Adapt the recogniser to one voice: a synthetic one, or a person who speaks for the robot.

    Every fifth sentence is not trained on: it grades the result, and weights that do not recognise
    the voice better are refused. The command needs the extra `train` (torch). To use the weights,
    write `motion: {weights: my.npz}` into the YAML of the face.
    """
    check_extra("torch", "learn adapt")
    from lipservo_lab.corpus.transcribed import read_transcribed
    from lipservo_lab.evaluation.recognition.recognition_scores import settled_score
    from lipservo_lab.learning.adaptation.voice import VoiceError, only_speaker, read_voice
    from lipservo_lab.learning.adaptation.voice_learning import AdaptationPlan
    from lipservo_lab.learning.adaptation.voice_learning import adapt as adapted
    from lipsync.recognition.network import (
        ADAPTED_FROM,
        adapted_from,
        find_weights,
        is_weights,
        save_weights,
        weights_digest,
    )

    start = find_weights(weights)
    check_output(output, replaces=is_weights, kind="weights", inputs=[Path(weights)])
    n_jobs = jobs or os.cpu_count() or 1
    plan = AdaptationPlan(
        n_steps=steps, peak_rate=rate, n_copies=copies, seed=seed, n_threads=n_jobs
    )
    with progress_bar(quiet=quiet) as advance:
        voice = read_voice(only_speaker(read_transcribed(voice_folder), speaker), advance, n_jobs)
        held_out = [sentence.speech for sentence in voice.held_out]
        before = settled_score(start, held_out).figures()
        learned = adapted(start, [sentence.speech for sentence in voice.learned], plan, advance)
        after = settled_score(learned, held_out).figures()
    is_better = after["viseme_speech"] > before["viseme_speech"]
    figures = {
        "weights": weights,
        "sentences": len(voice.learned),
        "seconds": round(voice.learned_s, 1),
        "held_out_sentences": len(voice.held_out),
        "held_out_seconds": round(voice.held_out_s, 1),
        "left_out": dict(voice.left_out),
        "before": {key: before[key] for key in _GRADED},
        "after": {key: after[key] for key in _GRADED},
        "better": is_better,
    }
    if as_json:
        print_json(figures)
    else:
        _print_grades(voice, before, after)
    if not is_better:
        raise VoiceError(
            f"{output}: not written, since the adapted weights do not recognise this voice better "
            f"than {weights}; keep those, or record more of the voice"
        )
    about = {
        **figures,
        "weights": Path(weights).name,
        ADAPTED_FROM: adapted_from(weights) or weights_digest(weights),
        "voice": voice_folder.resolve().name,
        "seed": seed,
        "steps": plan.n_steps,
    }
    save_weights(learned, output, {**about, "lipservo": version("lipservo")})
    MESSAGES.print(
        f"{output}: done; write `motion: {{weights: {output}}}` in the face YAML", soft_wrap=True
    )


def _print_grades(voice: "Voice", before: dict[str, float], after: dict[str, float]) -> None:
    """Print what the network was adapted to, what was left out, and figures before and after."""
    for name, reason in voice.left_out.items():
        MESSAGES.print(f"left out: {name}: {reason}", soft_wrap=True)
    RESULTS.print(
        f"learned from {len(voice.learned)} sentences, {voice.learned_s:.0f} s; "
        f"graded on {len(voice.held_out)} others, {voice.held_out_s:.0f} s:"
    )
    table = Table("", "before", "after", box=None, pad_edge=False)
    for key, label in _GRADED.items():
        table.add_row(label, f"{before[key]:.3f}", f"{after[key]:.3f}")
    RESULTS.print(table)


Record = Mapping[str, float]


class TrainingLogError(UserError):
    """A run log that cannot be drawn; the message is one line."""


def read_log(path: Path) -> list[Record]:
    """Return the records of a `log.jsonl`.

    Raises TrainingLogError for a file that is not one.
    """
    try:
        records = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    except OSError as error:
        raise TrainingLogError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise TrainingLogError(f"{path}: no training log: not one JSON object a line") from error
    if not records or not all(
        isinstance(r, dict) and {"step", "loss"} <= r.keys() for r in records
    ):
        raise TrainingLogError(f"{path}: no training log: every line must hold a step and a loss")
    return records


def draw_log(records: Sequence[Record], picture: Path) -> None:
    """Draw the loss, and accuracies of visemes by condition, over the training steps."""
    without_screen()
    from matplotlib import pyplot as plt

    figure, (losses, accuracies) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    losses.plot([r["step"] for r in records], [r["loss"] for r in records])
    losses.set(xlabel="step", ylabel="loss", title="training")
    validated = [r for r in records if len(r) > 2]
    for key in sorted(validated[-1]) if validated else ():
        if key == "score" or key.endswith("_viseme_all"):
            points = [(r["step"], r[key]) for r in validated if key in r]
            name = key.removesuffix("_viseme_all").removeprefix("corpus_").replace("_", " ")
            accuracies.plot(*zip(*points, strict=True), marker="o", label=name)
    accuracies.set(xlabel="step", ylabel="visemes right, all frames", title="validation speakers")
    if accuracies.lines:
        accuracies.legend(fontsize="small")
    save_picture(figure, picture)
    plt.close(figure)
