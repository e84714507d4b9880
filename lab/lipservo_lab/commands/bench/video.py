"""`lipservo bench motion --video`: our mouth beside faces that anybody filmed."""

import time
from pathlib import Path
from typing import Any, cast

from rich.table import Table

from lipservo.terminal.output import MESSAGES, RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipsync.extras import check_extra
from lipsync.motion.live_synthesizer import LIVE_STRATEGY

_HEADINGS = {
    "clip": "clip",
    "gap_r": "gap r",
    "loudness_r": "loudness r",
    "best_shift_ms": "best at ms",
    "gap_r_at_best": "gap r there",
    "seconds": "s",
}


def measure_video(
    folder: Path, landmarker: Path | None, model: Path | None, *, as_json: bool, quiet: bool
) -> None:
    """Print how our lip gap, by the sound alone, goes with the one that is filmed."""
    from lipservo_lab.bench.video.foreign_faces import foreign_figures
    from lipservo_lab.video.video_clips import find_clips
    from lipsync.video.tracking.trackers import open_tracker

    began_s = time.perf_counter()
    check_extra("av", "bench motion --video")
    clips = find_clips(folder)
    tracker = open_tracker(landmarker)
    with progress_bar(quiet=quiet) as advance:
        figures = foreign_figures(clips, tracker, model, advance)
    answer = {
        **figures,
        "default_strategy": LIVE_STRATEGY,
        "machine": machine_class(),
        "wall_s": round(time.perf_counter() - began_s, 1),
    }
    if as_json:
        print_json(answer)
        return
    rows = cast("list[dict[str, Any]]", figures["clips"])
    table = Table(*_HEADINGS.values(), box=None, pad_edge=False)
    for row in [r for r in rows if not r["left_out"]]:
        table.add_row(*(str(row[name]) for name in _HEADINGS))
    table.add_row("all", *(str(figures[name]) for name in list(_HEADINGS)[1:]))
    RESULTS.print(table)
    for row in rows:
        if row["left_out"]:
            MESSAGES.print(f"left out: {row['clip']}: {row['left_out']}", soft_wrap=True)
