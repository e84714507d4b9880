"""The figures of Wei and Deng that can be drawn; needs matplotlib, the extra `plots`.

Figure 1: how much a live recogniser agrees with the labels. Figure 6: how often no AnimPho is both
right and connected. Figures 4 and 5 are an example by hand, held by a test; their face is the twin.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.bench.pictures.motion_plots import COLOURS
from lipservo_lab.evaluation.motion.paper_tables import PRINTED_AGREEMENT, PRINTED_PRIORITY_MISSES

Rows = Sequence[Mapping[str, object]]

#: What is drawn into the folder.
PAPER_PICTURES: Final = ("figure-1.png", "figure-6.png")
_BAR_WIDTH: Final = 0.8


def draw_paper(folder: Path, tables: Mapping[str, Rows]) -> None:
    """Draw figure_1 and figure_6 of `paper_tables`, with what the paper prints as grey."""
    agreement, misses = PAPER_PICTURES
    _bars(folder / agreement, tables["figure_1"], "agrees with the labels", PRINTED_AGREEMENT)
    printed = (PRINTED_PRIORITY_MISSES - 0.01, PRINTED_PRIORITY_MISSES + 0.01)
    _bars(folder / misses, tables["figure_6"], "misses", printed)


def _bars(path: Path, rows: Rows, label: str, printed: tuple[float, float]) -> None:
    """A group of bars for each row, whose first cell names it; `printed` is shaded."""
    without_screen()
    from matplotlib import pyplot as plt

    first, *names = [name for name in rows[0] if not name.startswith("printed")]
    figure, axis = plt.subplots(figsize=(9, 4), layout="constrained")
    axis.axhspan(*printed, color="0.85", label="printed", zorder=0)
    width = _BAR_WIDTH / len(names)
    for number, name in enumerate(names):
        at = np.arange(len(rows)) + (number - (len(names) - 1) / 2.0) * width
        heights = [float(str(row[name])) for row in rows]
        axis.bar(at, heights, width, label=name, color=COLOURS.get(name))
    axis.set_xticks(range(len(rows)), [str(row[first]) for row in rows], fontsize=8)
    axis.set_ylim(0.0, 1.0)
    axis.set_ylabel(label)
    figure.legend(loc="outside upper center", ncols=1 + len(names), fontsize=8)
    save_picture(figure, path)
    plt.close(figure)
