"""`learn face`: a face model is learned from recordings.

`learn soft`: a face model is fitted to a recogniser's posteriors. `learn offline`: the model that
scripted lines are rendered with.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from lipservo.commands.options import Json, Model, Quiet, SkipBad, WeightsChoice
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipservo_lab.commands.options import ModelOutput, OtherWeights, Seed
from lipservo_lab.commands.work_bars import work_bars
from lipsync.errors import UserError
from lipsync.output_file import check_output
from lipsync.recognition.network import DEFAULT_WEIGHTS

if TYPE_CHECKING:
    from lipservo_lab.corpus.utterance import Corpus
    from lipservo_lab.learning.motion.several_speakers import FaceMap


#: What the predicted mean motion is learned from: labels alone, or recognised phonemes too.
Phonemes = Literal["both", "true"]


def train(
    corpora: Annotated[
        list[Path],
        typer.Argument(
            metavar="CORPUS...",
            help="Folder of recordings (sounds, landmarks, labels), one for each speaker.",
        ),
    ],
    output: ModelOutput,
    seed: Seed = 0,
    components: Annotated[
        int | None, typer.Option(help="Number of principal components of the face; default: 8.")
    ] = None,
    markers: Annotated[
        str | None,
        typer.Option(
            help="Points of a face: 39, 47 (default) or 478, or a JSON file (docs/motion.md)."
        ),
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="As Wei and Deng's paper: --components 5 --markers 39.")
    ] = False,
    phonemes: Annotated[
        Phonemes,
        typer.Option(
            help="both: learn from the labels and from what the shipped recogniser finds; true: "
            "from the labels alone, which is quicker."
        ),
    ] = "both",
    face_of: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="With several speakers: folder name of the speaker whose face is used; default: "
            "the first.",
        ),
    ] = None,
    weight: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=W",
            help="With several speakers: frames of the speaker with folder NAME count W times; "
            "default: 1.",
        ),
    ] = None,
    without_words: Annotated[
        str | None,
        typer.Option(help="Leave out sentences that have any of these words, commas between."),
    ] = None,
    without: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Text file of sentences to leave out, one name a line."),
    ] = None,
    skip_bad: SkipBad = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn a face model from recorded speech with mouth motion.

    For each sentence, CORPUS has audio/NAME.flac, landmarks/NAME.npz and labels/NAME.TextGrid;
    landmarks.json lists the landmarks: docs/motion.md, "A corpus of your own". The motion of
    several speakers is scaled to the face of one: docs/motion.md, "Several speakers". --paper: Wei
    and Deng, docs/motion.md, "The paper's method".
    """
    from lipservo_lab.corpus.grid import folder_name, read_grid
    from lipservo_lab.learning.expectation.deviation import hear_sentences
    from lipservo_lab.learning.motion.face_training import DEFAULT_COMPONENTS, check_components
    from lipservo_lab.learning.motion.face_training import train as train_model
    from lipservo_lab.learning.motion.several_speakers import check_speakers, on_one_face
    from lipservo_lab.learning.motion.trained_model import save_model
    from lipsync.face.model import is_model
    from lipsync.markers import MARKERS_47, find_layout
    from lipsync.recognition.network import load_shipped_weights

    if paper:
        if markers is not None or components is not None:
            raise typer.BadParameter("--paper is --components 5 --markers 39; leave these out")
        markers, components = "39", 5
    layout = MARKERS_47 if markers is None else find_layout(markers)
    n_components = DEFAULT_COMPONENTS if components is None else components
    check_components(n_components, layout)
    weights = _parse_weights(weight or [])
    check_speakers([folder_name(folder) for folder in corpora], face_of, weights)
    left_out = _read_names(without)
    words = frozenset(w.strip() for w in (without_words or "").split(",") if w.strip())
    check_output(output, replaces=is_model, kind="face model")
    with work_bars(quiet=quiet) as bars:
        read_corpora = [
            read_grid(folder, layout, skip_bad=skip_bad, progress=bars.read) for folder in corpora
        ]
        unknown = left_out - {u.name for corpus in read_corpora for u in corpus.utterances}
        if unknown:
            raise UserError(f"{without}: no such sentence: {', '.join(sorted(unknown)[:3])}")
        if words or left_out:
            read_corpora = [corpus.without(words, left_out) for corpus in read_corpora]
        sentences, maps = on_one_face(read_corpora, face_of=face_of, weights=weights)
        heard = None
        if phonemes == "both":
            heard = hear_sentences(
                load_shipped_weights(), sentences.labelled().utterances, bars.listen
            )
        model = train_model(
            sentences, seed=seed, n_components=n_components, heard=heard, progress=bars.tell
        )
    save_model(model, output)
    for line in sentences.skipped:
        MESSAGES.print(f"left out: {line}", soft_wrap=True)
    figures: dict[str, object] = {
        "model": str(output),
        "sentences": len(model.training_sentences),
        "layout": layout.name,
        "points": layout.n_points,
        "components": model.n_components,
        "animphos": len(model.animphos),
        "mean_successors": model.animphos.mean_successors,
        "skipped": len(sentences.skipped),
        **model.provenance,
        **_speaker_rows(read_corpora, weights, maps),
    }
    if as_json:
        print_json(figures)
        return
    RESULTS.print(
        f"{output}: {model.n_components} components of {layout.n_points} points, "
        f"{len(model.animphos)} AnimPhos from {model.provenance['segments']} segments of "
        f"{len(model.training_sentences)} sentences, {model.animphos.mean_successors:.2f} "
        f"successors on average (the paper: 3.45), {model.provenance['variance_held']:.1%} of "
        "the variance held",
    )
    for name, face_map in maps.items():
        x, y, z = face_map.scale
        RESULTS.print(
            f"{name}: turned by {face_map.angle_deg:.1f} degrees, motion times {x:.2f} in width, "
            f"{y:.2f} in height, {z:.2f} in depth",
        )


def _read_names(path: Path | None) -> frozenset[str]:
    """Return the sentences that a text file names, one a line; none for path None.

    Raises UserError for a file that cannot be read or names none.
    """
    if path is None:
        return frozenset()
    try:
        names = frozenset(line.strip() for line in path.read_text(encoding="utf-8").splitlines())
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"--without {path}: cannot be read as text: {error}") from error
    if not names - {""}:
        raise UserError(f"--without {path}: names no sentence; write one per line")
    return names - {""}


def _parse_weights(options: list[str]) -> dict[str, float]:
    """Return the weights of options NAME=W by name; raises BadParameter for another form."""
    weights: dict[str, float] = {}
    for option in options:
        name, _, number = option.rpartition("=")
        try:
            weights[name] = float(number)
        except ValueError:
            name = ""
        if not name:
            raise typer.BadParameter(
                f"{option!r}: write NAME=W, such as me=0.3", param_hint="--weight"
            )
    return weights


def _speaker_rows(
    corpora: "list[Corpus]", weights: Mapping[str, float], maps: "Mapping[str, FaceMap]"
) -> dict[str, object]:
    """Return for JSON how much speech each speaker has, and how the motion was mapped.

    Empty for a single speaker. maps: to the face that is used, by speaker.
    """
    if len(corpora) == 1:
        return {}
    speakers: dict[str, dict[str, object]] = {}
    for corpus in corpora:
        utterances = corpus.labelled().utterances
        speakers[corpus.name] = {
            "sentences": len(utterances),
            "minutes": round(
                sum(len(u.markers_mm) / u.frame_rate_hz for u in utterances) / 60.0, 2
            ),
            "weight": weights.get(corpus.name, 1.0),
        }
        if corpus.name in maps:
            face_map = maps[corpus.name]
            speakers[corpus.name]["turned_deg"] = round(face_map.angle_deg, 2)
            speakers[corpus.name]["scale_xyz"] = [round(float(s), 3) for s in face_map.scale]
    return {"speakers": speakers}


def train_soft(
    corpus: Annotated[
        Path, typer.Argument(help="Folder of recordings that the face model was learned from.")
    ],
    output: ModelOutput,
    model: Model = None,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    also: OtherWeights = None,
    table: Annotated[
        bool,
        typer.Option(
            "--table",
            help="Also train models without the test sentences in splits.json, fit them to the "
            "same weights, and print how well lip-readers read their motion, beside the required "
            "figures.",
        ),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit a face model to a recogniser's phoneme probabilities, frame by frame.

    Each sentence is recognised as it is and in four other voices and rooms. A face model that was
    not fitted is moved by the one phoneme that the recogniser finds likeliest.
    """
    from lipservo_lab.bench.readability.soft_table import soft_table
    from lipservo_lab.corpus.grid import read_grid
    from lipservo_lab.evaluation.readability.reading_scores import reading_parts
    from lipservo_lab.learning.expectation.soft_training import hear_copies
    from lipservo_lab.learning.motion.model_teacher import (
        ModelTeacher,
        taught_sentences,
        with_soft_expectation,
    )
    from lipservo_lab.learning.motion.trained_model import load_trained_model, save_model
    from lipsync.face.model import is_model
    from lipsync.recognition.network import find_weights, load_weights, weights_digest

    start_s = time.perf_counter()
    face = load_trained_model(model)
    network, digest = find_weights(weights), weights_digest(weights)
    check_output(output, replaces=is_model, kind="face model")
    with work_bars(quiet=quiet) as bars:
        sentences = read_grid(
            corpus, face.layout, head_reference_mm=face.head_reference_mm, progress=bars.read
        ).labelled()
        taught = taught_sentences(face, sentences)
        parts = reading_parts(corpus, sentences) if table else []

        bars.tell("posteriors to faces")
        others = [load_weights(path) for path in also or ()]
        other_digests = ",".join(weights_digest(str(path)) for path in also or ())
        teacher = None
        if table:
            teacher = ModelTeacher(sentences, weights, bars.track, bars.tell, others)
        copies = (
            hear_copies(network, taught, bars.track, others) if teacher is None else teacher.copies
        )
        fitted = with_soft_expectation(face, sentences, copies, digest)
        fitted = replace(fitted, provenance={**fitted.provenance, "soft_others": other_digests})
        if fitted.soft is None:
            raise UserError(f"{corpus}: too little speech with sound to learn from; record more")
        save_model(fitted, output)
        rows = []
        if teacher is not None:
            rows = soft_table(sentences, parts, teacher, weights, bars.track)
    figures: dict[str, object] = {
        "model": str(output),
        "weights": weights,
        "soft_weights": digest,
        "sentences": len(fitted.training_sentences),
        "bytes": output.stat().st_size,
        "seconds": round(time.perf_counter() - start_s, 1),
    }
    if table:
        figures["table"] = rows
    if as_json:
        print_json(figures)
        return
    for row in rows:
        RESULTS.print(f"{row['figure']}: {row['measured']} (bar {row['bar']})", highlight=False)
    RESULTS.print(
        f"{output}: fitted to weights {weights} by {figures['sentences']} sentences in "
        f"{figures['seconds']} s",
    )


def train_offline(
    corpus: Annotated[
        Path, typer.Argument(help="One speaker's recordings, a folder as in docs/motion.md.")
    ],
    output: ModelOutput,
    model: Model = None,
    states: Annotated[
        int | None, typer.Option(min=2, help="Number of mouth states; default: 100.")
    ] = None,
    components: Annotated[
        int | None, typer.Option(min=1, help="Principal components of the states; default: 10.")
    ] = None,
    markers: Annotated[
        str | None,
        typer.Option(
            help="Layout file with more points than the face model: layout.json in the corpus of "
            "`learn import-scans`; default: the face model's points."
        ),
    ] = None,
    seed: Seed = 0,
    skip_bad: SkipBad = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn the offline model that `lines render` needs beside a face model.

    The offline model holds states of the mouth, pieces of recorded motion, and networks that
    predict the face from the sound. CORPUS is a folder as for `lipservo learn face`; --model is the
    face model that was learned from this folder.
    """
    from lipservo_lab.corpus.grid import read_grid
    from lipservo_lab.learning.offline.offline_training import train_offline as train_model
    from lipservo_lab.learning.offline.state_training import Recipe
    from lipsync.face.model import load_face
    from lipsync.markers import find_layout
    from lipsync.offline.offline_model_file import is_offline_model, save_offline_model
    from lipsync.output_file import check_output

    face = load_face(model)
    standard = Recipe()
    recipe = Recipe(
        n_components=components or standard.n_components,
        n_states=states or standard.n_states,
        seed=seed,
    )
    check_output(output, replaces=is_offline_model, kind="offline model", inputs=[model])
    start_s = time.perf_counter()
    with work_bars(quiet=quiet) as bars:
        sentences = read_grid(
            corpus,
            face.layout if markers is None else find_layout(markers),
            head_reference_mm=face.head_reference_mm,
            skip_bad=skip_bad,
            progress=bars.read,
        )
        trained = train_model(sentences, face, recipe, progress=bars.tell, listening=bars.listen)
    save_offline_model(trained, output)
    seconds = time.perf_counter() - start_s
    for line in sentences.skipped:
        MESSAGES.print(f"left out: {line}", soft_wrap=True)
    figures: dict[str, object] = {
        "model": str(output),
        "face": trained.face_checksum,
        "sentences": len(trained.training_sentences),
        "skipped": len(sentences.skipped),
        "seconds": round(seconds, 1),
        "bytes": output.stat().st_size,
        **trained.provenance,
    }
    if as_json:
        print_json(figures)
        return
    RESULTS.print(
        f"{output}: {figures['states']} states and {figures['units']} units of "
        f"{figures['sentences']} sentences, {output.stat().st_size / 1e6:.1f} MB, in "
        f"{seconds:.0f} s",
    )
