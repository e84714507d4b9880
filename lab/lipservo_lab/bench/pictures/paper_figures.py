"""The papers' figures that can be drawn; needs matplotlib, the extra `plots`.

Wei and Deng's Figure 1: how much a live recogniser agrees with the labels. Figure 6: how often no
AnimPho is both right and connected. Figures 4 and 5: what the two strategies choose in the paper's
example. Edge, Hilton and Jackson's: how much of the variance so many modes of lip shape hold.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.bench.pictures.motion_plots import COLOURS
from lipservo_lab.evaluation.motion.paper_tables import PRINTED_AGREEMENT, PRINTED_PRIORITY_MISSES
from lipservo_lab.evaluation.motion.worked_example import FOLLOWS, SAYS, choices, example_units
from lipsync.animpho.selection import STRATEGIES

Rows = Sequence[Mapping[str, object]]

#: What is drawn into the folder.
PAPER_PICTURES: Final = (
    "figure-1.png", "figure-4-5.png", "figure-6.png", "edge-modes.png",
)  # fmt: skip
_BAR_WIDTH: Final = 0.8


def draw_paper(folder: Path, tables: Mapping[str, Rows]) -> None:
    """Draw `PAPER_PICTURES` into a folder from tables of `paper_tables` and `edge_tables`.

    Figures 1 and 6 of Wei and Deng, the paper's own values in grey; their example of selection; and
    the modes of Edge, Hilton and Jackson if `tables` has "edge_modes".
    """
    agreement, example, misses, modes = PAPER_PICTURES
    _draw_example(folder / example)
    _draw_bars(folder / agreement, tables["figure_1"], "agrees with the labels", PRINTED_AGREEMENT)
    printed = (PRINTED_PRIORITY_MISSES - 0.01, PRINTED_PRIORITY_MISSES + 0.01)
    _draw_bars(folder / misses, tables["figure_6"], "misses", printed)
    if "edge_modes" in tables:
        _draw_modes(folder / modes, tables["edge_modes"])


def _draw_bars(path: Path, rows: Rows, label: str, printed: tuple[float, float]) -> None:
    """Draw a group of bars for each row, named by its first cell; shade the range `printed`."""
    without_screen()
    from matplotlib import pyplot as plt

    label_key, *names = [name for name in rows[0] if not name.startswith("printed")]
    figure, axis = plt.subplots(figsize=(9, 4), layout="constrained")
    axis.axhspan(*printed, color="0.85", label="printed", zorder=0)
    width = _BAR_WIDTH / len(names)
    for number, name in enumerate(names):
        positions = np.arange(len(rows)) + (number - (len(names) - 1) / 2.0) * width
        heights = [float(str(row[name])) for row in rows]
        axis.bar(positions, heights, width, label=name, color=COLOURS.get(name))
    axis.set_xticks(range(len(rows)), [str(row[label_key]) for row in rows], fontsize=8)
    axis.set_ylim(0.0, 1.0)
    axis.set_ylabel(label)
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


def _draw_example(path: Path) -> None:
    """Draw the paper's example of selection: a panel for each strategy, a column for each phoneme.

    Numbers are AnimPhos (recorded pieces of motion); arrows lead to those that followed them in the
    recording; coloured are those that the strategy chooses.
    """
    without_screen()
    from matplotlib import pyplot as plt

    units, names = example_units(), ("naive", "priority")
    # Where each AnimPho of the example is drawn: a column for each phoneme.
    at = {
        number: (column, -line)
        for column, numbers in enumerate(SAYS.values())
        for line, number in enumerate(numbers)
    }
    figure, axes = plt.subplots(1, len(names), figsize=(9, 4), layout="constrained")
    for axis, name in zip(axes, names, strict=True):
        chosen = choices(STRATEGIES[name], units, *SAYS)
        for previous, follower in FOLLOWS:
            arrow = {"arrowstyle": "->", "shrinkA": 18, "shrinkB": 18}
            axis.annotate("", at[follower], at[previous], arrowprops=arrow)
        for position, choice in enumerate(chosen):
            colour = "tab:red" if choice.missed else "tab:green"
            axis.plot(*at[choice.animpho], "o", markersize=28, color=colour, alpha=0.4)
            if position:
                ends = zip(at[chosen[position - 1].animpho], at[choice.animpho], strict=True)
                axis.plot(*ends, ":", color=colour)
        for number, (column, line) in at.items():
            lengths = chosen[column].chain_lengths
            length = f"\nv = {lengths[number]:.0f}" if len(lengths) else ""
            axis.text(column, line, f"{number}{length}", ha="center", va="center", fontsize=9)
        axis.set_xticks(range(len(SAYS)), [f"/{phoneme}/" for phoneme in SAYS])
        axis.set_yticks([])
        axis.set_xlim(-0.5, len(SAYS) - 0.5)
        axis.set_ylim(-2.6, 0.6)
        n_missed = sum(choice.missed for choice in chosen)
        axis.set_title(f"{name}: {n_missed} of {len(chosen) - 1} missed")
    figure.supxlabel(
        "arrows: who follows whom in training; green, red: chosen, and missed", fontsize=9
    )
    save_picture(figure, path)
    plt.close(figure)
