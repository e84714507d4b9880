"""`import-scans`: dense scans of a talking face become a corpus that `train` learns from.

`import-video`: video of a talking face becomes a corpus that `train` learns from.
"""

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from lipservo.commands.options import Json, Landmarker, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, Advance, print_json, progress_bar
from lipsync.errors import UserError, check_extra, check_inputs

if TYPE_CHECKING:
    from lipservo_lab.scans.scan_import import ScanImport
    from lipservo_lab.scans.takes import Take, TakeSound
    from lipservo_lab.video.video_import import VideoImport


def import_video(
    source: Annotated[Path, typer.Argument(help="A video, or a folder of videos, of one talker.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Corpus folder to write.")],
    landmarker: Landmarker = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make recordings for `learn face` from video of a face that talks to the camera.

    The words come from NAME.txt beside NAME.mp4, or from a line NAME ... in transcripts.txt;
    without them the phonemes are recognised. docs/own-face.md explains how to film.
    """
    from lipservo_lab.bench.pictures.import_sheets import draw_sheet
    from lipservo_lab.video.video_clips import find_clips
    from lipservo_lab.video.video_import import check_corpus_folder, import_videos, write_corpus
    from lipsync.video.face_tracker import open_tracker

    start_s = time.perf_counter()
    check_inputs(source, landmarker)
    check_extra("ai_edge_litert", "learn import-video")
    check_extra("matplotlib", "the picture sheet of import-video")
    check_corpus_folder(output)
    clips = find_clips(source)
    tracker = open_tracker(landmarker)
    with progress_bar(quiet=quiet) as advance:
        imported = import_videos(clips, tracker, advance)
        about = {"source": str(source), "tracker": tracker.name, **_summary(imported)}
        write_corpus(output, imported, about, advance, partial(draw_sheet, imported.samples))
    seconds = round(time.perf_counter() - start_s, 1)
    reports = [report.as_json() for report in imported.reports]
    if as_json:
        print_json({"corpus": str(output), **about, "seconds": seconds, "clips": reports})
        return
    _print_reports(imported)
    RESULTS.print(_summary_line(output, about, seconds), soft_wrap=True)


def _summary(imported: "VideoImport") -> dict[str, Any]:
    """Return an import's figures; at least one clip must have been used."""
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


def _print_reports(imported: "VideoImport") -> None:
    """Print notes, and clips left out with the reasons."""
    for report in imported.reports:
        for note in report.notes:
            MESSAGES.print(f"{report.clip}: {note}", soft_wrap=True)
        if report.left_out is not None:
            MESSAGES.print(f"left out: {report.clip}: {report.left_out}", soft_wrap=True)


def _summary_line(output: Path, about: dict[str, Any], seconds: float) -> str:
    """Return the last line that `import-video` prints.

    about: figures of `_summary`, and the tracker's name.
    """
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


_MOTION_ENDING = ".npz"


def import_scans(
    folder: Annotated[
        Path, typer.Argument(help="Folder of scans (PLY, OBJ), or of folders, one for each take.")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="Corpus folder to write, or FILE.npz for motion alone."
        ),
    ],
    rate_hz: Annotated[float, typer.Option(min=1.0, max=1000.0, help="Scans per second.")] = 60.0,
    template: Annotated[
        Path | None,
        typer.Option(
            help="A scan of the same face at rest, mouth closed; default: the first scan."
        ),
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of the scans: mm, cm, m or in.")] = "mm",
    axes: Annotated[
        str, typer.Option(help="Scan axes that point right, up and to the viewer, such as x,z,-y.")
    ] = "x,y,z",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make recordings for `learn face` from 3-D scans of a face, each with a mesh of its own.

    Beside each take's folder NAME: NAME.wav, its sound; NAME.TextGrid or NAME.txt, its words
    (without them the phonemes are recognised); NAME.markers.csv, named points (docs/own-face.md).
    """
    check_inputs(folder, template)
    check_extra("trimesh", "learn import-scans")
    check_extra("matplotlib", "the picture sheet of import-scans")
    from lipservo.terminal.pictures import check_picture
    from lipservo_lab.output_folder import check_output_folder
    from lipservo_lab.scans.scan import scan_frame
    from lipservo_lab.scans.scan_corpus import is_motion
    from lipservo_lab.scans.scan_import import begin_import
    from lipservo_lab.scans.takes import find_takes
    from lipsync.output_file import check_output

    start_s = time.perf_counter()
    frame = scan_frame(unit, axes)
    is_corpus = output.suffix != _MOTION_ENDING
    picture = output / "scans.png" if is_corpus else output.with_suffix(".png")
    if is_corpus:
        check_output_folder(output, "corpus")
    else:
        check_output(output, replaces=is_motion, kind="registered motion")
        check_picture(picture)
    takes = find_takes(folder, template)
    with progress_bar(quiet=quiet) as advance:
        sounds = _sounds(takes, rate_hz, advance) if is_corpus else {}
        usable = [take for take in takes if not isinstance(sounds.get(take.name), str)]
        imported = begin_import(usable, frame, rate_hz, template, advance)
        if is_corpus:
            about = _write_corpus(output, imported, takes, sounds, advance)
        else:
            about = _write_motion(output, imported, takes, picture, advance)
    about["seconds"] = round(time.perf_counter() - start_s, 1)
    if as_json:
        print_json({"output": str(output), **about})
        return
    for report in about["takes"]:
        for note in report["notes"]:
            MESSAGES.print(f"{report['take']}: {note}", soft_wrap=True)
    for report in (*about["scans"], *about["takes"]):
        if report["left_out"] is not None:
            name = "/".join(
                report[key] for key in ("take", "scan") if isinstance(report.get(key), str)
            )
            MESSAGES.print(f"left out: {name}: {report['left_out']}", soft_wrap=True)
    RESULTS.print(
        _import_scans_in_words(output, picture, about, is_corpus=is_corpus), soft_wrap=True
    )


def _sounds(
    takes: "tuple[Take, ...]", rate_hz: float, advance: Advance
) -> "dict[str, TakeSound | str]":
    """Return sound and labels of each take, or why it has none.

    Raises ScanError if no take has any.
    """
    from lipservo_lab.scans.scan import ScanError
    from lipservo_lab.scans.takes import take_sound

    found: dict[str, TakeSound | str] = {}
    for number, take in enumerate(takes, start=1):
        try:
            found[take.name] = take_sound(take, rate_hz)
        except UserError as error:
            found[take.name] = str(error)
        advance("listening", number, len(takes))
    reasons = [f"{name}: {why}" for name, why in found.items() if isinstance(why, str)]
    if len(reasons) == len(found):
        raise ScanError(f"nothing usable: {'; '.join(reasons[:2])}")
    return found


def _write_corpus(
    output: Path,
    imported: "ScanImport",
    takes: "tuple[Take, ...]",
    sounds: "dict[str, TakeSound | str]",
    advance: Advance,
) -> dict[str, Any]:
    """Register the scans, write the corpus folder `output` with a picture; return the figures.

    sounds: by take; a take with a reason in place of its sound is left out. The folder is written
    completely or not at all.
    """
    from lipservo_lab.bench.pictures.import_sheets import draw_scans
    from lipservo_lab.output_folder import folder_written_whole
    from lipservo_lab.scans.scan_corpus import CorpusWriter

    with folder_written_whole(output) as place:
        writer = CorpusWriter(place, imported.template, imported.rate_hz)
        for registered in imported.registered(advance):
            sound = sounds[registered.take.name]
            if not isinstance(sound, str):
                writer.add(registered, sound)
        imported.refuse_nothing()
        about = _about(imported, takes, sounds)
        writer.finish(about)
        draw_scans(imported.samples, imported.template, place / "scans.png")
    return about


def _write_motion(
    output: Path,
    imported: "ScanImport",
    takes: "tuple[Take, ...]",
    picture: Path,
    advance: Advance,
) -> dict[str, Any]:
    """Register the scans, write their motion, without sound, and a picture; return figures."""
    from lipservo_lab.bench.pictures.import_sheets import draw_scans
    from lipservo_lab.scans.scan_corpus import write_motion

    registered = list(imported.registered(advance))
    imported.refuse_nothing()
    about = _about(imported, takes, {})
    write_motion(output, registered, imported.template, imported.rate_hz, about)
    draw_scans(imported.samples, imported.template, picture)
    return about


def _about(
    imported: "ScanImport", takes: "tuple[Take, ...]", sounds: "dict[str, TakeSound | str]"
) -> dict[str, Any]:
    """Return figures of the whole import, then the reports of takes and of scans."""
    report_of = {report.take: report for report in imported.takes}
    take_rows = []
    for take in takes:
        sound = sounds.get(take.name)
        if isinstance(sound, str):
            take_rows.append(
                {"take": take.name, "scans": len(take.scans), "left_out": sound, "notes": ()}
            )
        else:
            text_source = None if sound is None else sound.source
            take_rows.append({**report_of[take.name].as_json(), "phonemes": text_source})
    used = [report for report in imported.scans if report.left_out is None]
    return {
        "template": str(imported.neutral),
        "points": len(imported.template.landmarks),
        "rate_hz": imported.rate_hz,
        "used_takes": sum(row["left_out"] is None for row in take_rows),
        "used_scans": len(used),
        "left_out_scans": len(imported.scans) - len(used),
        "error_mm": round(float(np.median([report.error_mm or 0.0 for report in used])), 3),
        "matched": round(float(np.mean([report.matched or 0.0 for report in used])), 3),
        "takes": take_rows,
        "scans": [report.as_json() for report in imported.scans],
    }


def _import_scans_in_words(
    output: Path, picture: Path, about: dict[str, Any], *, is_corpus: bool
) -> str:
    """Return the closing sentence of `import-scans`. about: the figures of the import."""
    then = f", then `lipservo learn face {output} -o face.npz`" if is_corpus else ""
    return (
        f"{output}: {about['used_scans']} scans of {about['used_takes']} takes on "
        f"{about['points']} points, {about['left_out_scans']} left out; {about['error_mm']:.2f} mm "
        f"off their surface (median), {about['matched']:.0%} matched; {about['seconds']:.0f} s; "
        f"look at {picture}{then}"
    )
