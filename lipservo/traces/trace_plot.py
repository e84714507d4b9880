"""A picture of two traces over one another; needs matplotlib, the extra `plots`."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lipservo.terminal.pictures import is_picture
from lipservo.traces.trace_diff import Overlay
from lipservo.traces.trace_reader import Trace
from lipsync.errors import UserError
from lipsync.extras import check_extra
from lipsync.markers import CLOSED_GAP_MM
from lipsync.output_file import check_output, written_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The servos that differ most, one panel each.
_SERVOS = 3
_SUFFIXES = (".png", ".svg")


def check_plot(path: Path) -> None:
    """See that there is something to draw with, and a place for it.

    Raises UserError for another kind of picture, OutputError, MissingExtraError.
    """
    if path.suffix not in _SUFFIXES:
        raise UserError(f"{path}: --plot draws {' or '.join(_SUFFIXES)}")
    check_extra("matplotlib", "--plot")
    check_output(path, replaces=_is_drawing, kind="PNG or SVG picture")


def _is_drawing(head: bytes) -> bool:
    return is_picture(head) or (head.startswith(b"<?xml") and b"svg" in head)


def draw_difference(path: Path, first: Trace, second: Trace, laid: Overlay) -> None:
    """Lip gaps, how far lips are apart, and the servos that differ most, against sound time."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    apart_deg = np.abs(laid.sent_deg[1] - laid.sent_deg[0]).max(axis=0)
    servos = np.argsort(apart_deg)[::-1][:_SERVOS].tolist()
    figure, axes = plt.subplots(
        2 + len(servos), 1, sharex=True, figsize=(11, 4 + 1.8 * len(servos)), layout="constrained"
    )
    gap, apart = axes[0], axes[1]
    for trace, curve, style in zip((first, second), laid.gaps_mm, ("-", "--"), strict=True):
        gap.plot(laid.sound_s, curve, style, label=trace.name, linewidth=1.2)
    gap.axhline(CLOSED_GAP_MM, color="0.5", linewidth=0.6, linestyle=":")
    gap.set_ylabel("lip gap, mm")
    gap.legend(fontsize=8)
    _name_phonemes(gap, laid)
    apart.fill_between(laid.sound_s, laid.lips_mm, color="tab:red", linewidth=0.0)
    apart.set_ylabel("lips apart,\nmm rms")
    for axis, servo in zip(axes[2:], servos, strict=True):
        for curve, style in zip(laid.sent_deg, ("-", "--"), strict=True):
            axis.plot(laid.sound_s, curve[:, servo], style, linewidth=1.0)
        axis.set_ylabel(f"{first.servos[servo]},\ndeg", fontsize=8)
    axes[-1].set_xlabel("sound time, s")
    with written_whole(path) as file:
        figure.savefig(file, dpi=110, format=path.suffix[1:])
    plt.close(figure)


def _name_phonemes(axis: "Axes", laid: Overlay) -> None:
    """Those of the first trace above the axis, on two lines in turn."""
    place = axis.get_xaxis_transform()
    before, n = "", 0
    for time_s, (phoneme, _) in zip(laid.sound_s.tolist(), laid.phonemes, strict=True):
        if phoneme != before:
            axis.text(time_s, 1.02 + 0.08 * (n % 2), phoneme, fontsize=6, transform=place)
            n += 1
        before = phoneme
