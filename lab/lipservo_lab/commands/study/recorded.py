"""`lipservo study recorded`: a recorded sentence as a performance, to be filmed beside a method."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from lipservo.commands.options import Model
from lipservo.terminal.output import MESSAGES
from lipsync.errors import UserError


def recorded(
    corpus: Annotated[Path, typer.Argument(help="Folder of recordings as in docs/motion.md.")],
    sentence: Annotated[str, typer.Argument(help="Name of a recorded sentence.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Performance to write (.perf).")],
    model: Model = None,
) -> None:
    """Write a recorded sentence (a person's face motion and sound) as a performance file.

    `lipservo film SOUND --beside FILE.perf` shows this face beside a synthesised one; `lipservo
    lines perform FILE.perf` lets a robot play it.
    """
    from lipservo_lab.corpus.grid import read_grid
    from lipsync.face.model import load_face
    from lipsync.offline.performance import (
        RATE_HZ,
        SUFFIX,
        Performance,
        is_performance,
        performed_sound,
        write_performance,
    )
    from lipsync.output_file import check_output

    if output.suffix != SUFFIX:
        raise UserError(f"{output}: the name of a performance must end in {SUFFIX}")
    check_output(output, replaces=is_performance, kind="performance", inputs=[])
    face = load_face(model)
    utterances = read_grid(corpus, face.layout, skip_bad=True).utterances
    found = next((each for each in utterances if each.name == sentence), None)
    if found is None:
        names = ", ".join(each.name for each in utterances[:5])
        raise UserError(f"{corpus}: no sentence {sentence}; there are {names} ...")
    motion = face.coefficients(found.markers_mm)
    frames_s = np.arange(len(motion)) / found.frame_rate_hz
    times_s = np.arange(int(frames_s[-1] * RATE_HZ) + 1) / RATE_HZ
    columns = [np.interp(times_s, frames_s, column) for column in motion.T]
    faces = np.stack(columns, axis=1).astype(np.float32)
    sound = performed_sound(found.sound_path, included=True)
    phones = tuple(each for each in found.phones if each.end_s is not None)
    write_performance(Performance(face.checksum, faces, phones, sound, "recorded"), output)
    MESSAGES.print(f"{output}: {times_s[-1]:.1f} s, as recorded; its sound is {found.sound_path}")
