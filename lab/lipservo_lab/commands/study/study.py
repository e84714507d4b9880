"""`lipservo study`: `make`, `serve`, `report` one with people; `rehearse`, `power` before."""

import contextlib
import secrets
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from lipservo.commands.options import (
    DashboardListen,
    Json,
    Landmarker,
    Quiet,
    SkipBad,
)
from lipservo.terminal.output import MESSAGES, RESULTS, machine_class, print_json
from lipservo_lab.commands.bench.printing import print_table
from lipservo_lab.commands.options import Inverted, Lazy, Seed
from lipservo_lab.commands.work_bars import WorkBars, work_bars
from lipsync.errors import check_extra, check_inputs

if TYPE_CHECKING:
    from lipservo.display.film import Display
    from lipservo_lab.corpus.utterance import Corpus
    from lipservo_lab.learning.motion.trained_model import TrainedModel
    from lipservo_lab.study.making import Film

_METHODS = "recorded,ears,words,scripted,wei-deng,edge,cohen-massaro,catmull-rom,rhubarb,still"
#: Size of the clips: square, so that the face fills it; raters judge the mouth.
_SIZE = (640, 640)
Folder = Annotated[Path, typer.Argument(help="Folder of the study.")]
Ratings = Annotated[int, typer.Option(min=0, max=400, help="Number of clips a rater rates.")]
Pairs = Annotated[int, typer.Option(min=0, max=400, help="Number of pairs a rater compares.")]
Sentences = Annotated[int, typer.Option(min=0, max=2000, help="Number of sentences to be rated.")]


def make(
    folder: Annotated[Path, typer.Argument(help="Folder of the study, to write.")],
    corpus: Annotated[
        Path, typer.Option(help="Folder of recordings, with splits.json (docs/motion.md).")
    ],
    methods: Annotated[
        str, typer.Option(help="Methods to compare, commas between (docs/study.md).")
    ] = _METHODS,
    ratings: Ratings = 40,
    pairs: Pairs = 20,
    readings: Annotated[
        int, typer.Option(min=0, max=400, help="Number of clips that a rater lip-reads.")
    ] = 10,
    sentences: Sentences = 20,
    face: Annotated[
        str, typer.Option(help="Face to film: twin (drawn), or a photograph of a face.")
    ] = "twin",
    landmarker: Landmarker = None,
    model: Annotated[
        Path | None,
        typer.Option(
            help="Face model trained without the sentences that are shown, random_test in "
            "splits.json; default: train one now."
        ),
    ] = None,
    title: Annotated[str, typer.Option(help="Title of the raters' page.")] = "Talking faces",
    consent: Annotated[
        Path | None, typer.Option(help="Text file that raters agree to; default: the shipped text.")
    ] = None,
    seed: Annotated[
        str | None, typer.Option(help="Seed of rating sheets and clip names; default: random.")
    ] = None,
    skip_bad: SkipBad = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Film the clips of a study, and make a sheet of clips for each rater, blind and balanced.

    --ratings, --readings and --sentences are rounded up to multiples of the number of methods.
    Raters get FOLDER/served only; FOLDER/key.json lists which clip shows which method.
    """
    from lipservo_lab.corpus.grid import read_grid
    from lipservo_lab.output_folder import check_output_folder
    from lipservo_lab.study.making import (
        Material,
        Plan,
        held_out,
        planned_study,
        write_made_study,
    )
    from lipservo_lab.study.sheets import Size
    from lipservo_lab.study.shown_methods import chosen_methods, faces_of_methods
    from lipsync.markers import MARKERS_47

    size = Size(ratings, pairs, readings, sentences)
    names = chosen_methods(methods)
    check_inputs(corpus, consent, model, landmarker)
    check_output_folder(folder, "study")
    check_extra("av", "filming a study")
    plan = Plan(names, size, seed or secrets.token_hex(8), title, _consent_text(consent))
    with work_bars(quiet=quiet) as bars:
        recordings = read_grid(corpus, MARKERS_47, skip_bad=skip_bad, progress=bars.read).labelled()
        test_names = _test_of(corpus, recordings)
        learned = tuple(u for u in recordings.utterances if u.name not in test_names)
        test_sentences = held_out(recordings, test_names, plan.seed)
        study, key = planned_study(plan, test_sentences, learned)
        trained = _model_for(recordings, test_names, model, bars)
        material = Material(trained, test_sentences, learned, faces_of_methods(trained, recordings))
        film = _film_on(face, landmarker, trained)
        write_made_study(folder, study, key, material, film, partial(bars.advance, "filming"))
    summary = {
        "study": study.identity, "folder": str(folder), "methods": list(names),
        "clips": len(key.clips), "items_per_rater": len(study.sheets[0]),
    }  # fmt: skip
    if as_json:
        print_json(summary)
        return
    RESULTS.print(
        f"{folder}: {len(key.clips)} clips of {len(names)} methods, {len(study.sheets[0])} items a "
        f"rater. Now: lipservo study serve {folder}",
        soft_wrap=True,
    )


def _consent_text(path: Path | None) -> str:
    """Return the consent text that raters read: of a file, or the shipped one for None."""
    from lipservo_lab.study.sheets import StudyError

    if path is None:
        return (files("lipservo_lab.study.page") / "consent.txt").read_text("utf-8")
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise StudyError(f"{path}: cannot be read as a text ({error})") from error


def _test_of(folder: Path, recordings: "Corpus") -> frozenset[str]:
    """Return the names of the held-out sentences, `random_test` of splits.json."""
    from lipservo_lab.evaluation.readability.reading_scores import KNOWN, reading_parts

    return next(part.test for part in reading_parts(folder, recordings) if part.split == KNOWN)


def _model_for(
    recordings: "Corpus", test: frozenset[str], path: Path | None, bars: WorkBars
) -> "TrainedModel":
    """Return the given model, or one trained now, that has not learned the shown sentences.

    A model would repeat a sentence that it has learned. Raises StudyError for a given model that
    has.
    """
    from lipservo_lab.learning.motion.model_teacher import ModelTeacher
    from lipservo_lab.learning.motion.trained_model import load_trained_model
    from lipservo_lab.study.sheets import StudyError
    from lipsync.recognition.network import DEFAULT_WEIGHTS

    if path is not None:
        model = load_trained_model(path)
        seen = sorted(test.intersection(model.training_sentences))
        if seen:
            raise StudyError(
                f"{path}: was trained on {len(seen)} of the sentences to be shown ({seen[0]}, "
                "...); give one trained without them, or leave --model out"
            )
        return model
    training_part = recordings.keep({u.name for u in recordings.utterances if u.name not in test})
    return ModelTeacher(training_part, DEFAULT_WEIGHTS, bars.track, bars.tell)(training_part)


def _film_on(face: str, landmarker: Path | None, model: "TrainedModel") -> "Film":
    """Return a function that films faces, with the same head for all clips.

    face: "twin", or the path of a photograph.
    """
    from lipservo.display.film import film
    from lipservo.display.filmed_faces import photograph
    from lipservo.display.photo_display import PhotoDisplay
    from lipservo.display.shipped_faces import twin_face
    from lipsync.arrays import Array
    from lipsync.face.frame import Frame

    filmed_face = (
        twin_face(model, _SIZE)
        if face == "twin"
        else photograph(Path(face), None, landmarker, _SIZE, model)
    )
    display: Display = PhotoDisplay(filmed_face)

    def film_clip(faces: Array, rate_hz: float, sound: Path, out: Path) -> None:
        frames = (Frame(n / rate_hz, face) for n, face in enumerate(faces))
        film(frames, sound, display, out, rate_hz=round(rate_hz))

    return film_clip


def serve(
    folder: Folder,
    listen: DashboardListen = None,
    quiet: Quiet = False,
) -> None:
    """Show a study to raters in a browser, and store their answers.

    For raters on other computers: --listen 0.0.0.0:8080. All raters open the address that is
    printed; each continues where they stopped, also after a restart.
    """
    for library in ("starlette", "uvicorn"):
        check_extra(library, "serving a study")
    from lipservo.dashboard.child import address_of, bound_dashboard
    from lipservo.dashboard.web.serving import server_of
    from lipservo_lab.study.answers import AnswerFile
    from lipservo_lab.study.serving import StudyDesk, minutes_of, study_app, study_token
    from lipservo_lab.study.sheets import ANSWERS_FILE, StudyError, missing_clips, read_study

    study = read_study(folder)
    missing = missing_clips(folder, study)
    if missing:
        raise StudyError(
            f"{folder}: {len(missing)} of {len(study.duration_s)} clips are missing "
            f"({missing[0]}, ...); copy them back, or make the study anew"
        )
    token = study_token(folder)
    with (
        AnswerFile(folder / ANSWERS_FILE, study.identity) as answers,
        bound_dashboard(listen, token) as listener,
    ):
        if answers.n_torn and not quiet:
            MESSAGES.print(
                f"{answers.path}: its last line was cut short ({answers.n_torn} bytes); it lies in "
                f"{answers.path.name}.torn, and its rater is asked again",
                soft_wrap=True,
            )

        def ready() -> None:
            if not quiet:
                MESSAGES.print(f"study: {address_of(listener, token)}", soft_wrap=True)

        app = study_app(StudyDesk(study, answers, minutes_of(study)), folder, token)
        # Ctrl-C ends the server, which raises it again when every request is answered.
        with contextlib.suppress(KeyboardInterrupt):
            server_of(app, ready).run([listener])
        if not quiet:
            n_finished = sum(
                len(rater.answers) == len(study.sheets[rater.sheet])
                for rater in answers.raters.values()
            )
            MESSAGES.print(
                f"{answers.path}: {len(answers.raters)} raters, {n_finished} to the end. "
                f"lipservo study report {folder}",
                soft_wrap=True,
            )


def report(
    folder: Folder,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="HTML file to write; default: report.html in the folder."
        ),
    ] = None,
    answers: Annotated[
        Path | None,
        typer.Option(help="Answers file, as `study rehearse` writes; default: people's answers."),
    ] = None,
    mixed: Annotated[
        bool, typer.Option(help="Also fit a linear mixed model (extra `study`; half a minute).")
    ] = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print a study's results; write a page with their intervals, pictures, and raters left out."""
    from lipservo_lab.study.answers import now, read_answers
    from lipservo_lab.study.counted import counted
    from lipservo_lab.study.mixed_model import mixed_model
    from lipservo_lab.study.report_page import report_page
    from lipservo_lab.study.sheets import ANSWERS_FILE, MACHINES_FILE, read_key, read_study
    from lipservo_lab.study.study_figures import machine_tables, study_figures
    from lipsync.output_file import check_output, write_whole

    check_inputs(folder, answers)
    check_extra("matplotlib", "the pictures of a report")
    if mixed:
        check_extra("statsmodels", "a linear mixed model (--no-mixed leaves it out)")
    path = output or folder / "report.html"
    check_output(path, replaces=_is_page, kind="page", inputs=[answers])
    study, key = read_study(folder), read_key(folder)
    file = answers or folder / ANSWERS_FILE
    read = read_answers(file, study.identity)
    with work_bars(quiet=quiet) as bars:
        bars.tell("counting")
        counted_answers = counted(study, key, read)
        reference = key.methods.index("recorded") if "recorded" in key.methods else 0
        fitted = mixed_model(counted_answers.tables, reference) if mixed else None
        machines = machine_tables(folder / MACHINES_FILE, study, key)
        figures = study_figures(study, key, counted_answers, fitted, machines)
        about = f"Study {study.identity}, answers of {file.name}, reported {now()}"
        page = report_page(figures, about=about, is_rehearsal=read.is_simulated)
        write_whole(path, page)
    if as_json:
        print_json(figures)
        return
    _print_figures(figures)
    RESULTS.print(f"{path}", soft_wrap=True)


def _is_page(head: bytes) -> bool:
    """Return whether a file that begins with `head` is an HTML page."""
    return head.startswith(b"<!doctype html>")


#: Columns of the table of ratings, with their headings.
_RATING_HEADINGS = {
    "method": "method",
    "mean": "mean",
    "mean_95": "95 %",
    "less_reference": "less reference",
    "less_reference_95": "95 %",
}


def _print_figures(figures: dict[str, object]) -> None:
    """Print who was counted and the table of ratings; the rest is on the report's page."""
    raters = figures["raters"]
    assert isinstance(raters, dict)
    left_out = ", ".join(f"{n} {reason}" for reason, n in raters["left_out"].items()) or "nobody"
    RESULTS.print(f"{raters['began']} raters, {raters['counted']} counted; left out: {left_out}")
    rows = figures["ratings"]
    assert isinstance(rows, list)
    print_table(rows, _RATING_HEADINGS)


def rehearse(
    folder: Folder,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Answers file to write; default: rehearsal.jsonl in the folder."
        ),
    ] = None,
    raters: Annotated[int, typer.Option(min=1, max=1000, help="Number of careful raters.")] = 20,
    lazy: Lazy = 1,
    inverted: Inverted = 1,
    seed: Seed = 0,
) -> None:
    """Let simulated raters, whose preferences are known, answer a study before people do.

    They prefer the methods in the order in which `study make --methods` named them.
    """
    import numpy as np

    from lipservo_lab.study.answers import line_of
    from lipservo_lab.study.rehearsal import Crew
    from lipservo_lab.study.sheets import read_key, read_study
    from lipservo_lab.study.simulated_raters import even_taste, simulated_records
    from lipsync.output_file import check_output, write_whole

    path = output or folder / "rehearsal.jsonl"
    check_output(path, replaces=_is_rehearsal, kind="rehearsal")
    study, key = read_study(folder), read_key(folder)
    characters = Crew(raters, lazy, lazy, lazy, inverted).characters
    records = simulated_records(
        study, key, even_taste(key.methods), characters, np.random.default_rng(seed)
    )
    write_whole(path, b"".join(map(line_of, records)))
    RESULTS.print(
        f"{path}: {len(characters)} simulated raters. lipservo study report {folder} "
        f"--answers {path}",
        soft_wrap=True,
    )


def _is_rehearsal(head: bytes) -> bool:
    """Return whether a file is of simulated answers; people's answers are never overwritten."""
    return b'"simulated"' in head.partition(b"\n")[0]


def power(
    raters: Annotated[str, typer.Option(help="Numbers of raters, commas between.")] = "5,10,20,40",
    methods: Annotated[int, typer.Option(min=2, max=20, help="Number of methods to compare.")] = 10,
    ratings: Ratings = 40,
    sentences: Sentences = 20,
    studies: Annotated[
        int, typer.Option(min=10, max=10_000, help="Studies to simulate for each number of raters.")
    ] = 100,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate studies to find how many raters it takes to see a difference between methods.

    For each number of raters: in what share of the simulated studies a difference of so many points
    of the scale is significant.
    """
    from lipservo_lab.study.rehearsal import power_rows
    from lipservo_lab.study.sheets import Size, StudyError

    try:
        counts = [int(text) for text in raters.split(",")]
    except ValueError:
        raise StudyError(f"--raters {raters}: give numbers with commas, such as 10,20") from None
    if min(counts) < 2:
        raise StudyError("--raters: 2 or more, or the spread between raters is unknown")
    size = Size(ratings, 0, 0, sentences, sheets=max(counts))
    with work_bars(quiet=quiet) as bars:
        rows = power_rows(
            counts, methods, size, studies, lambda n: bars.track("simulating", range(n))
        )
    about = {
        "methods": methods, "ratings": ratings, "sentences": sentences, "studies": studies,
        "machine": machine_class(),
    }  # fmt: skip
    if as_json:
        print_json({"rows": rows, **about})
        return
    gaps = list(rows[0]["seen"])
    table = Table(
        "raters", *(f"{gap:.2f}" for gap in gaps), "seen in 4 of 5", box=None, pad_edge=False,
        title="Share of studies that see a difference of so many points", title_justify="left",
    )  # fmt: skip
    for row in rows:
        shares = (f"{row['seen'][gap]:.2f}" for gap in gaps)
        smallest = row["smallest_seen"]
        table.add_row(str(row["raters"]), *shares, "" if smallest is None else f"{smallest:.2f}")
    RESULTS.print(table)
    RESULTS.print(f"{methods} methods, {ratings} ratings a rater, {sentences} sentences")
