"""`adapt`: the recogniser's weights learn one voice."""

import os
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from lipservo.commands.options import Json, Quiet, WeightsChoice
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipsync.extras import check_extra
from lipsync.output_file import check_output
from lipsync.recognition.weights import DEFAULT_WEIGHTS

if TYPE_CHECKING:
    from lipservo_lab.learning.adaptation.voice import Voice

#: What is graded, in words for the table.
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
            help="Folder of 2 to 10 minutes of one voice: NAME.wav and beside it NAME.txt, what is "
            "said in it; or a corpus as for `train-recognizer`."
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The weights to write.")],
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    speaker: Annotated[
        str | None,
        typer.Option(help="Of a corpus of several speakers: this one.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same weights.")] = 0,
    steps: Annotated[int, typer.Option(min=1, help="Steps of learning.")] = 100,
    rate: Annotated[
        float, typer.Option(min=0.0, max=0.01, help="Learning rate at its peak.")
    ] = 5e-4,
    copies: Annotated[int, typer.Option(min=0, help="Disturbed copies of the voice.")] = 2,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Processes, and threads of learning; default: one a core.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Adapt the recogniser to one voice: a synthetic one, or whoever speaks for the robot.

    Every fifth sentence is not learned from but graded on; weights that do not hear the voice
    better are refused. Needs the extra `train` (torch). Use them with `run --weights my.npz`.
    """
    check_extra("torch", "learn adapt")
    from lipservo_lab.corpus.transcribed import read_transcribed
    from lipservo_lab.evaluation.recognition.settled_score import settled_score
    from lipservo_lab.learning.adaptation.voice import VoiceError, only_speaker, read_voice
    from lipservo_lab.learning.adaptation.voice_learning import AdaptationPlan
    from lipservo_lab.learning.adaptation.voice_learning import adapt as adapted
    from lipsync.recognition.weights import find_weights, is_weights, save_weights

    start = find_weights(weights)
    check_output(output, replaces=is_weights, kind="weights", inputs=[Path(weights)])
    n_jobs = jobs or os.cpu_count() or 1
    plan = AdaptationPlan(
        n_steps=steps, peak_rate=rate, n_copies=copies, seed=seed, n_threads=n_jobs
    )
    with progress_bar(quiet=quiet) as advance:
        voice = read_voice(only_speaker(read_transcribed(voice_folder), speaker), advance, n_jobs)
        heard = [sentence.speech for sentence in voice.held_out]
        before = settled_score(start, heard).figures()
        learned = adapted(start, [sentence.speech for sentence in voice.learned], plan, advance)
        after = settled_score(learned, heard).figures()
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
        _print(voice, before, after)
    if not is_better:
        raise VoiceError(
            f"{output}: not written, since the adapted weights do not hear this voice better than "
            f"{weights}; keep those, or record more of the voice"
        )
    about = {
        **figures,
        "weights": Path(weights).name,
        "voice": voice_folder.resolve().name,
        "seed": seed,
        "steps": plan.n_steps,
    }
    save_weights(learned, output, {**about, "lipservo": version("lipservo")})
    MESSAGES.print(f"{output}: done; `lipservo run --weights {output}`", soft_wrap=True)


def _print(voice: "Voice", before: dict[str, float], after: dict[str, float]) -> None:
    for name, reason in voice.left_out.items():
        MESSAGES.print(f"left out: {name}: {reason}", soft_wrap=True)
    RESULTS.print(
        f"learned from {len(voice.learned)} sentences, {voice.learned_s:.0f} s; "
        f"graded on {len(voice.held_out)} others, {voice.held_out_s:.0f} s:"
    )
    table = Table("", "before", "after", box=None, pad_edge=False)
    for key, told in _GRADED.items():
        table.add_row(told, f"{before[key]:.3f}", f"{after[key]:.3f}")
    RESULTS.print(table)
