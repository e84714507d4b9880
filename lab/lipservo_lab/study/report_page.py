"""The report of a study as one HTML page: pictures drawn into it, nothing loaded from elsewhere."""

import io
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lipservo.terminal.pictures import without_screen
from lipservo_lab.study.counted import REASONS
from lipservo_lab.study.sheets import POINTS
from lipservo_lab.study.shown_methods import RECORDED
from lipservo_lab.study.study_figures import PEOPLE, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK, _SOFT, _OURS, _OTHER = "#1d2730", "#6b7780", "#14518f", "#b1560f"
_OURS_NAMES: Final = ("ears", "words", "scripted")
_STYLE: Final = (files("lipservo_lab.study.page") / "report.css").read_text("utf-8")


def report_page(figures: Row, *, about: str, is_rehearsal: bool) -> str:
    """Return the report as one HTML page.

    figures: of `study_figures`. about: where and when, in a line.
    """
    raters = figures["raters"]
    parts = [
        f"<h1>{escape(figures['title'])}</h1>",
        '<p class="trial">A rehearsal: these raters were simulated.</p>' if is_rehearsal else "",
        f'<p class="soft">{escape(about)}</p>',
        _headline(figures),
        "<h2>Raters</h2>",
        f"<p>{raters['began']} began, {raters['counted']} are counted.</p>",
        _left_out(raters["left_out_raters"]),
    ]
    if any(row["answers"] for row in figures["ratings"]):
        parts += _ratings(figures)
    if any(row["answers"] for row in figures["pairs"]):
        parts += _pairs(figures)
    if any(row["answers"] for rows in figures["reading"].values() for row in rows):
        parts += _reading(figures)
    parts += [_NOTES]
    body = "\n".join(part for part in parts if part)
    return (
        '<!doctype html>\n<html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(figures['title'])}: report</title><style>{_STYLE}</style>\n{body}</html>\n"
    )


_NOTES: Final = """<h2>How to read it</h2>
<div class="notes">
<p>Intervals are 95 %: with other raters and other sentences the figure would lie there. Both are
drawn anew (cluster bootstrap); two methods differ where the interval of their difference, not of
each, leaves out 0. Nothing is corrected for the number of comparisons.</p>
<p>The mixed model takes the five points for even steps and its parts for normal; where it and the
bootstrap disagree, believe the bootstrap.</p>
<p>Who is left out was decided by rules that were there before the answers; the column <em>all
raters</em> shows the means with everybody who did at least half.</p>
</div>"""


def _headline(figures: Row) -> str:
    """Return as HTML how each of our methods is rated beside the reference, in a sentence each."""
    lines = []
    for row in figures["ratings"]:
        ends = row["less_reference_95"]
        if row["method"] not in _OURS_NAMES or ends is None:
            continue
        against = "the recorded face" if figures["reference"] == RECORDED else figures["reference"]
        low, high = ends
        if low > 0 or high < 0:
            verdict = f"{abs(row['less_reference']):.2f} points {'above' if low > 0 else 'below'}"
        else:
            verdict = "not told apart from"
        lines.append(
            f"<li><b>{escape(row['label'])}</b> is rated {row['mean']:.2f}, {verdict} {against} "
            f"({_ends(ends)}).</li>"
        )
    return f"<ul>{''.join(lines)}</ul>"


def _left_out(reasons: Mapping[str, str]) -> str:
    """Return the HTML table of raters that were left out.

    reasons: by rater.
    """
    if not reasons:
        return "<p>Nobody was left out.</p>"
    rows = [[escape(name), REASONS[reason]] for name, reason in sorted(reasons.items())]  # type: ignore[index]
    return _table(["left out", "because this rater"], rows, n_texts=2)


def _ratings(figures: Row) -> list[str]:
    """Return the HTML of the ratings: heading, picture, table, and the mixed model's spread."""
    rows = _ordered(figures["ratings"], "mean")
    cells = [
        [
            escape(r["label"]), str(r["answers"]), _value(r["mean"]), _ends(r["mean_95"]),
            _signed(r["less_reference"]), _ends(r["less_reference_95"]), _value(r["mixed"]),
            _ends(r["mixed_95"]), _value(r["all_raters"]),
        ]
        for r in rows
    ]  # fmt: skip
    heads = ["method", "ratings", "mean", "95 %", "difference", "95 %", "mixed model", "95 %"]
    found = [
        "<h2>How natural</h2>",
        "<p>1 is not at all natural, 5 completely natural.</p>",
        _picture(lambda axes: _draw_ratings(axes, rows), len(rows)),
        _table([*heads, "all raters"], cells, reference=_at(rows, figures["reference"])),
    ]
    spread = figures["mixed_spread"]
    if spread is not None:
        shares = ", ".join(f"{name} {value:.2f}" for name, value in spread.items())
        found.append(f'<p class="soft">Mixed model, standard deviations in points: {shares}.</p>')
    return found


def _pairs(figures: Row) -> list[str]:
    """Return the HTML of the pair comparisons: heading, picture, table, and who won over whom."""
    rows = _ordered(figures["pairs"], "strength")
    cells = [
        [
            escape(r["label"]), str(r["answers"]), f"{r['won']}", _signed(r["strength"]),
            _ends(r["strength_95"]), _signed(r["less_reference"]), _ends(r["less_reference_95"]),
        ]
        for r in rows
    ]  # fmt: skip
    heads = ["method", "shown", "chosen", "strength", "95 %", "difference", "95 %"]
    return [
        "<h2>Which of two</h2>",
        "<p>Strength by Bradley and Terry, in log odds: a method 1 above another is chosen over it "
        "73 times in 100, 2 above 88 times.</p>",
        _picture(lambda axes: _draw_pairs(axes, rows), len(rows)),
        _table(heads, cells, reference=_at(rows, figures["reference"])),
        "<h3>How often the row was chosen over the column</h3>",
        _won_table(figures["won_over"], rows),
    ]


def _won_table(won_over: Mapping[str, Mapping[str, int]], rows: Sequence[Row]) -> str:
    """Return an HTML table: how often the row's method was chosen over the column's."""
    names = [row["method"] for row in rows]
    cells = [
        [
            escape(row["label"]),
            *(str(won_over[row["method"]].get(other, "")) for other in names),
        ]
        for row in rows
    ]
    return _table(["", *(escape(name) for name in names)], cells)


def _reading(figures: Row) -> list[str]:
    """Return the HTML of what was read without sound, by people and by machines, best method first.

    The order is that of people's answers, or of the first machine's where no person has read.
    """
    reading = figures["reading"]
    people = _ordered(reading[PEOPLE], "words_right")
    if not any(row["answers"] for row in people):
        people = _ordered(
            next(rows for name, rows in reading.items() if name != PEOPLE), "words_right"
        )
    order = [row["method"] for row in people]
    by_reader = {
        name: sorted(rows, key=lambda row: order.index(row["method"]))
        for name, rows in reading.items()
        if any(row["answers"] for row in rows)
    }
    cells = [
        [
            escape(row["label"]), escape(name), str(row["answers"]), _share(row["words_right"]),
            _share_ends(row["words_right_95"]), _share(row["chance"]),
            _share(row["above_chance"], sign="+"), _share_ends(row["above_chance_95"]),
        ]
        for method in range(len(order))
        for name, rows in by_reader.items()
        for row in [rows[method]]
    ]  # fmt: skip
    heads = ["method", "read by", "clips", "words right", "95 %", "chance", "above chance", "95 %"]
    return [
        "<h2>What can be read without sound</h2>",
        "<p>Share of words that was read right, in their order. Chance is what the same answers "
        "score on the other sentences of this part. The readers are machines, fitted on recorded "
        "words of sentences that this study does not show.</p>",
        _picture(lambda axes: _draw_reading(axes, by_reader), len(order)),
        _table(heads, cells, n_texts=2),
    ]


def _picture(draw: Any, n_rows: int) -> str:
    """Return an HTML figure with an SVG that `draw` draws on matplotlib axes."""
    without_screen()
    import matplotlib as mpl
    from matplotlib import pyplot as plt

    with mpl.rc_context({"font.size": 10, "svg.hashsalt": "lipservo", "font.family": "sans-serif"}):
        figure: Figure
        figure, axes = plt.subplots(figsize=(7.6, 0.9 + 0.36 * n_rows), layout="constrained")
        draw(axes)
        axes.invert_yaxis()
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x", color="#e4e9ec")
        axes.set_axisbelow(True)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
        plt.close(figure)
    svg = text.getvalue()
    return f"<figure>{svg[svg.index('<svg') :]}</figure>"


def _draw_ratings(axes: "Axes", rows: Sequence[Row]) -> None:
    """Draw each method's mean rating with its 95 % interval, and the mixed model's below it."""
    _dots(axes, rows, "mean")
    if any(row["mixed"] is not None for row in rows):
        y = np.arange(len(rows)) + 0.26
        ends = [row["mixed_95"] or [np.nan, np.nan] for row in rows]
        axes.hlines(y, *zip(*ends, strict=True), color=_SOFT, linewidth=0.9)
        axes.plot(_values(rows, "mixed"), y, "|", color=_SOFT, markersize=5, label="mixed model")
        axes.legend(loc="lower right", frameon=False, fontsize=9)
    axes.set_xlim(1, POINTS)
    axes.set_xticks(range(1, POINTS + 1))
    axes.set_xlabel("mean rating")


def _draw_pairs(axes: "Axes", rows: Sequence[Row]) -> None:
    """Draw each method's strength with its 95 % interval."""
    axes.axvline(0.0, color="#93a1ad", linewidth=0.8)
    _dots(axes, rows, "strength")
    axes.set_xlabel("strength, log odds")


def _draw_reading(axes: "Axes", by_reader: Mapping[str, Sequence[Row]]) -> None:
    """Draw the share of words read right, with 95 % intervals and chance, of each reader."""
    places = np.linspace(-0.22, 0.22, len(by_reader)) if len(by_reader) > 1 else [0.0]
    for place, mark, (name, rows) in zip(places, "o^s", by_reader.items(), strict=False):
        is_human = name == PEOPLE
        colour = _INK if is_human else _SOFT
        y = np.arange(len(rows)) + place
        ends = [row["words_right_95"] or [np.nan, np.nan] for row in rows]
        axes.hlines(y, *zip(*ends, strict=True), color=colour, linewidth=2.0 if is_human else 1.0)
        fill = colour if is_human else "white"
        axes.plot(_values(rows, "words_right"), y, mark, color=colour, label=name,
                  markersize=6 if is_human else 4.5, markerfacecolor=fill)  # fmt: skip
        axes.plot(_values(rows, "chance"), y, "|", color=_OTHER, markersize=7)
        axes.set_yticks(range(len(rows)), [row["label"] for row in rows])
    axes.plot([], [], "|", color=_OTHER, label="chance")
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("share of words read right")
    axes.legend(loc="lower right", frameon=False, fontsize=9)


def _values(rows: Sequence[Row], name: str) -> list[float]:
    return [np.nan if row[name] is None else row[name] for row in rows]


def _dots(axes: "Axes", rows: Sequence[Row], name: str) -> None:
    """Draw the value of each row that has one, with 95 % interval; label rows by their methods."""
    for at, row in enumerate(rows):
        if row[name] is None:
            continue
        colour = _colour(row["method"])
        if row[f"{name}_95"] is not None:
            axes.hlines(at, *row[f"{name}_95"], color=colour, linewidth=2.2)
        axes.plot(row[name], at, "o", color=colour, markersize=6.5)
    axes.set_yticks(range(len(rows)), [row["label"] for row in rows])
    for text, row in zip(axes.get_yticklabels(), rows, strict=True):
        text.set_color(_colour(row["method"]))


def _colour(method: str) -> str:
    if method in _OURS_NAMES:
        return _OURS
    return _INK if method == RECORDED else _OTHER


def _ordered(rows: Sequence[Row], name: str) -> list[Row]:
    """Return rows from the highest value of `name` down; rows without a value last."""
    return sorted(rows, key=lambda row: np.inf if row[name] is None else -row[name])


def _at(rows: Sequence[Row], method: str) -> int:
    """Return the index of the row of a method."""
    return [row["method"] for row in rows].index(method)


def _table(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    n_texts: int = 1,
    reference: int | None = None,
) -> str:
    """Return an HTML table.

    n_texts: columns from the left that hold text. reference: index of the row that is set apart.
    """
    kinds = ["" if n < n_texts else ' class="n"' for n in range(len(heads))]
    head = "".join(f"<th{kind}>{text}</th>" for kind, text in zip(kinds, heads, strict=True))
    body = ""
    for n, row in enumerate(rows):
        cells = "".join(f"<td{kind}>{text}</td>" for kind, text in zip(kinds, row, strict=True))
        body += f"<tr{' class=reference' if n == reference else ''}>{cells}</tr>\n"
    return f'<div class="scroll"><table><tr>{head}</tr>\n{body}</table></div>'


def _value(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _signed(value: float | None) -> str:
    return "" if not value else f"{value:+.2f}".replace("-", "\N{MINUS SIGN}")


def _ends(ends: Sequence[float] | None) -> str:
    return (
        ""
        if ends is None
        else f"{_value(ends[0])} to {_value(ends[1])}".replace("-", "\N{MINUS SIGN}")
    )


def _share(value: float | None, sign: str = "") -> str:
    return "" if value is None else f"{100 * value:{sign}.0f} %".replace("-", "\N{MINUS SIGN}")


def _share_ends(ends: Sequence[float] | None) -> str:
    return (
        ""
        if ends is None
        else f"{100 * ends[0]:.0f} to {100 * ends[1]:.0f}".replace("-", "\N{MINUS SIGN}")
    )
