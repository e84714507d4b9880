"""The papers' figures that can be drawn; needs matplotlib, the extra `plots`.

Wei and Deng's Figure 6: how often no AnimPho is both right and connected. Edge, Hilton and
Jackson's: how much of the variance so many modes of lip shape hold.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.bench.pictures.motion_plots import COLOURS
from lipservo_lab.evaluation.motion.paper_tables import PRINTED_PRIORITY_MISSES

Rows = Sequence[Mapping[str, object]]

#: What is drawn into the folder.
PAPER_PICTURES: Final = ("figure-6.png", "edge-modes.png")
_BAR_WIDTH: Final = 0.8


def draw_paper(folder: Path, tables: Mapping[str, Rows]) -> None:
    """Draw `PAPER_PICTURES` into a folder from tables of `paper_tables` and `edge_tables`.

    Figure 6 of Wei and Deng, the paper's own value in grey, and the modes of Edge, Hilton and
    Jackson if `tables` has "edge_modes".
    """
    misses, modes = PAPER_PICTURES
    _draw_misses(folder / misses, tables["figure_6"])
    if "edge_modes" in tables:
        _draw_modes(folder / modes, tables["edge_modes"])


def _draw_misses(path: Path, rows: Rows) -> None:
    """Draw the methods' miss rates, a group of bars for each phrase; the printed rate is shaded."""
    without_screen()
    from matplotlib import pyplot as plt

    label_key, *names = [name for name in rows[0] if not name.startswith("printed")]
    figure, axis = plt.subplots(figsize=(9, 4), layout="constrained")
    printed = PRINTED_PRIORITY_MISSES
    axis.axhspan(printed - 0.01, printed + 0.01, color="0.85", label="printed", zorder=0)
    width = _BAR_WIDTH / len(names)
    for number, name in enumerate(names):
        positions = np.arange(len(rows)) + (number - (len(names) - 1) / 2.0) * width
        heights = [float(str(row[name])) for row in rows]
        axis.bar(positions, heights, width, label=name, color=COLOURS.get(name))
    axis.set_xticks(range(len(rows)), [str(row[label_key]) for row in rows], fontsize=8)
    axis.set_ylim(0.0, 1.0)
    axis.set_ylabel("misses")
    figure.legend(loc="outside upper center", ncols=1 + len(names), fontsize=8)
    save_picture(figure, path)
    plt.close(figure)


def _draw_modes(path: Path, rows: Rows) -> None:
    """Draw the share of variance over the number of modes: ours a line, the printed ones dots."""
    without_screen()
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    axis.plot(*zip(*((row["modes"], row["ours"]) for row in rows), strict=True), label="ours")
    printed = [(row["modes"], row["printed"]) for row in rows if row["printed"] is not None]
    if printed:
        axis.plot(*zip(*printed, strict=True), "o", color="0.5", label="printed")
    axis.set_xscale("log")
    axis.set_ylim(0.0, 1.02)
    axis.set_xlabel("modes")
    axis.set_ylabel("share of the variance of all modes")
    axis.legend(loc="lower right")
    save_picture(figure, path)
    plt.close(figure)
