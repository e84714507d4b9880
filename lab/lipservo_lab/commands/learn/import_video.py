"""`import-video`: video of a talking face becomes a corpus that `train` learns from."""

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lipservo.commands.options import Json, Landmarker, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipsync.extras import check_extra

if TYPE_CHECKING:
    from lipservo_lab.video.video_import import VideoImport


def import_video(
    source: Annotated[Path, typer.Argument(help="A video, or a folder of them, of one talker.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The corpus folder to write.")],
    landmarker: Landmarker = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a corpus for `train` from video of a face that talks to the camera.

    NAME.txt beside NAME.mp4, or a line NAME ... in transcripts.txt, says what is said; without, it
    is recognised. docs/own-face.md says how to film.
    """
    from lipservo_lab.bench.video.face_sheet import draw_sheet
    from lipservo_lab.video.corpus_folder import check_corpus_folder, write_corpus
    from lipservo_lab.video.video_clips import find_clips
    from lipservo_lab.video.video_import import import_videos
    from lipsync.video.tracking.trackers import open_tracker

    began_s = time.perf_counter()
    check_extra("av", "learn import-video")
    check_extra("matplotlib", "the picture sheet of import-video")
    check_corpus_folder(output)
    clips = find_clips(source)
    tracker = open_tracker(landmarker)
    with progress_bar(quiet=quiet) as advance:
        imported = import_videos(clips, tracker, advance)
        about = {"source": str(source), "tracker": tracker.name, **_summary(imported)}
        write_corpus(output, imported, about, advance, partial(draw_sheet, imported.samples))
    seconds = round(time.perf_counter() - began_s, 1)
    reports = [report.as_json() for report in imported.reports]
    if as_json:
        print_json({"corpus": str(output), **about, "seconds": seconds, "clips": reports})
        return
    _tell(imported)
    RESULTS.print(_in_words(output, about, seconds), soft_wrap=True)


def _summary(imported: "VideoImport") -> dict[str, Any]:
    used = [report for report in imported.reports if report.left_out is None]
    shifts_ms = sorted(report.shift_ms or 0 for report in used)
    return {
        "used": len(used),
        "left_out": len(imported.reports) - len(used),
        "speech_seconds": round(sum(report.seconds for report in used), 1),
        "frame_rate_hz": imported.rate_hz,
        "recognised": sum(report.phonemes == "recognised" for report in used),
        "median_shift_ms": shifts_ms[len(shifts_ms) // 2],
    }


def _tell(imported: "VideoImport") -> None:
    for report in imported.reports:
        for note in report.notes:
            MESSAGES.print(f"{report.clip}: {note}", soft_wrap=True)
        if report.left_out is not None:
            MESSAGES.print(f"left out: {report.clip}: {report.left_out}", soft_wrap=True)


def _in_words(output: Path, about: dict[str, Any], seconds: float) -> str:
    texts = ""
    if about["recognised"]:
        texts = f"; {about['recognised']} without text: their phonemes were recognised"
    return (
        f"{output}: {about['used']} clips, {about['speech_seconds'] / 60:.1f} minutes at "
        f"{about['frame_rate_hz']:g} pictures a second, {about['left_out']} left out{texts}; sound "
        f"{about['median_shift_ms']:+d} ms from the picture (median); tracked by "
        f"{about['tracker']}; {seconds:.0f} s; look at {output / 'faces.png'}, then "
        f"`lipservo learn face {output} -o face.npz`"
    )
