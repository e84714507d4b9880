"""`lipservo bench display`: a warped photograph, and its film, against the wanted shapes."""

import time
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import progress_bar
from lipservo_lab.commands.bench.printing import print_figures
from lipservo_lab.commands.options import GridCorpus
from lipsync.errors import UserError, check_extra, check_inputs


def display(
    corpus: GridCorpus,
    sentences: Annotated[
        int | None,
        typer.Option(min=1, help="Number of sentences of random_test to use.", show_default="all"),
    ] = None,
    track: Annotated[
        bool,
        typer.Option(
            "--track", help="Also film the drawn face, and run a face tracker on the film."
        ),
    ] = False,
    landmarker: Annotated[
        Path | None,
        typer.Option(help="For --track: file face_landmarker.task; default: mediapipe's."),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure fold-overs and errors of warped photographs, and the sync of films.

    Three faces show every recorded frame of random_test, a list of sentences in splits.json.
    Without --track no face tracker is needed.
    """
    check_inputs(corpus, landmarker)
    check_extra("cv2", "drawing a photograph")
    check_extra("av", "making a film")
    from lipservo.display.photo_display import PhotoDisplay
    from lipservo.display.shipped_faces import twin_face
    from lipservo_lab.bench.display.film_figures import (
        film_sync_ms,
        held_out,
        seen_figures,
        tracked_film,
    )
    from lipservo_lab.bench.display.warp_figures import SIZE, known_faces, warp_figures
    from lipservo_lab.corpus.grid import read_grid
    from lipsync.face.model import load_face
    from lipsync.video.face_tracker import open_tracker

    began_s = time.perf_counter()
    tracker = open_tracker(landmarker) if track else None
    face = load_face()
    try:
        test = sorted(held_out(corpus))[:sentences]
    except OSError as error:
        raise UserError(f"{corpus}: no splits.json ({error.strerror}); give grid_s1") from error
    with progress_bar(quiet=quiet) as advance:
        advance("reading", 0, 1)
        recorded = read_grid(corpus, face.layout, skip_bad=True).utterances
        advance("reading", 1, 1)
        by_name = {each.name: each for each in recorded}
        motions = {name: face.coefficients(by_name[name].markers_mm) for name in test}
        figures = warp_figures(face, known_faces(corpus), motions, advance)
        figures |= {"film_sync_ms": round(film_sync_ms(), 2)}
        if tracker is not None:
            shown = PhotoDisplay(twin_face(face, SIZE))
            tracks = tracked_film(shown, face, motions, tracker, advance)
            figures |= seen_figures(face, tracks, motions, recorded)
    print_figures(figures, as_json=as_json, began_s=began_s)
