"""The picture of `lipservo bench readability`; needs matplotlib, the extra `plots`."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.bench.readability.readability_figures import HEADLINE_LOOKAHEAD_MS, RECORDED

#: What is drawn into the folder.
PICTURES = ("readability.png",)
Row = Mapping[str, object]
_COLOURS = {"true": "tab:blue", "recognized": "tab:orange", None: "0.4"}


def draw_readability(folder: Path, rows: Sequence[Row]) -> None:
    """A bar for each motion at 100 ms with its interval, a panel for each split and reader."""
    without_screen()
    from matplotlib import pyplot as plt

    shown = [r for r in rows if r["lookahead_ms"] in (None, HEADLINE_LOOKAHEAD_MS)]
    splits = list(dict.fromkeys(str(r["split"]) for r in shown))
    readers = list(dict.fromkeys(str(r["reader"]) for r in shown))
    n_bars = max(sum(r["split"] == s and r["reader"] == readers[0] for r in shown) for s in splits)
    figure, axes = plt.subplots(
        len(readers), len(splits), sharex=True, squeeze=False,
        figsize=(4.0 * len(splits), len(readers) * (1.0 + 0.3 * n_bars)), layout="constrained",
    )  # fmt: skip
    for line, reader in zip(axes, readers, strict=True):
        for axis, split in zip(line, splits, strict=True):
            mine = [r for r in shown if r["split"] == split and r["reader"] == reader]
            scores = np.array([r["score"] for r in mine], dtype=np.float64)
            ends = np.array([r["score_95"] for r in mine], dtype=np.float64)
            axis.barh(
                range(len(mine)), scores, xerr=np.abs(ends.T - scores), capsize=3,
                color=[_COLOURS[_phonemes(r)] for r in mine],
            )  # fmt: skip
            axis.set_yticks(range(len(mine)), [_label(r) for r in mine], fontsize=8)
            axis.invert_yaxis()
            axis.set_title(f"{split}, reader of {reader}", fontsize=10)
            axis.set_xlim(0.0, 1.0)
    for axis in axes[-1]:
        axis.set_xlabel("read right")
    save_picture(figure, folder / PICTURES[0])
    plt.close(figure)


def _phonemes(row: Row) -> str | None:
    return None if row["phonemes"] is None else str(row["phonemes"])


def _label(row: Row) -> str:
    names = [str(row["strategy"])]
    if row["strategy"] != RECORDED:
        names.append(str(row["phonemes"]))
    if row["face"] != "model":
        names.append(str(row["face"]))
    return ", ".join(names)
