"""All figures of a study, as `study report --json` prints them and as its page shows them."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from lipservo_lab.study.answers import RaterRecord
from lipservo_lab.study.counted import REASONS, Counted, Tables, tables_of
from lipservo_lab.study.estimates import Estimates, Figure, preferred, rated, words_read
from lipservo_lab.study.mixed_model import MixedModel
from lipservo_lab.study.sheets import Item, Key, Study, StudyError
from lipservo_lab.study.shown_methods import METHODS, RECORDED
from lipsync.arrays import Indices

Row = dict[str, Any]
PEOPLE: Final = "people"


def study_figures(
    study: Study,
    key: Key,
    counted: Counted,
    mixed: MixedModel | None,
    machines: Mapping[str, Tables],
) -> Row:
    """Return all figures of a study, for JSON and for the report's page.

    mixed: None where it was not fitted. machines: what each machine reader read, by its name.
    """
    reference = key.methods.index(RECORDED) if RECORDED in key.methods else 0
    tables = counted.tables
    reasons = Counter(counted.left_out.values())
    return {
        "study": study.identity,
        "title": study.title,
        "reference": key.methods[reference],
        "raters": {
            "began": counted.n_raters,
            "counted": len(tables.raters),
            "left_out": {reason: reasons[reason] for reason in REASONS if reasons[reason]},
            "left_out_raters": dict(counted.left_out),
        },
        "ratings": _ratings(counted, mixed, reference),
        "mixed_spread": None if mixed is None else mixed.spread,
        "pairs": _pairs(tables, reference),
        "won_over": _won_over(tables),
        "reading": {
            PEOPLE: _readings(tables, reference),
            **{name: _readings(each, reference) for name, each in machines.items()},
        },
    }


def _ratings(counted: Counted, mixed: MixedModel | None, reference: int) -> list[Row]:
    """Return a row a method: mean rating, difference from the reference, the same by mixed model.

    reference: index of the method that the others are compared with. mixed: None: not fitted.
    """
    tables = counted.tables
    estimates = rated(tables, reference)
    of_all = rated(counted.all_tables, reference)
    rows = _rows(tables, tables.ratings[:, 2], estimates, "mean")
    for n, row in enumerate(rows):
        row["all_raters"] = _number(of_all.own[n].value)
        mixed_mean = None if mixed is None else mixed.own[n]
        mixed_difference = None if mixed is None else mixed.less_reference[n]
        row |= _named("mixed", mixed_mean) | _named("mixed_less_reference", mixed_difference)
    return rows


def _pairs(tables: Tables, reference: int) -> list[Row]:
    """Return a row a method: strength, difference from the reference, times shown and chosen."""
    shown = tables.pairs[:, 2:].ravel()
    rows = _rows(tables, shown, preferred(tables, reference), "strength")
    for n, row in enumerate(rows):
        row["won"] = int((tables.pairs[:, 2] == n).sum())
    return rows


def _won_over(tables: Tables) -> dict[str, dict[str, int]]:
    """Return how often the first method was chosen over the second, by both names."""
    counts = Counter(map(tuple, tables.pairs[:, 2:].tolist()))
    return {
        one: {other: counts[i, j] for j, other in enumerate(tables.methods) if i != j}
        for i, one in enumerate(tables.methods)
    }


def _readings(tables: Tables, reference: int) -> list[Row]:
    """Return a row a method: share of words read right, that share above chance, and chance."""
    read_right, above = words_read(tables, reference)
    rows = _rows(tables, tables.readings[:, 2], read_right, "words_right")
    for n, row in enumerate(rows):
        row |= _named("above_chance", above.own[n])
        value, above_value = read_right.own[n].value, above.own[n].value
        row["chance"] = _number(value - above_value)
    return rows


def _rows(tables: Tables, method_of_answers: Indices, found: Estimates, name: str) -> list[Row]:
    """Return a row a method with its name, number of answers, estimate, and difference.

    method_of_answers: method index of each answer. name: of the estimate in the row.
    """
    counts = np.bincount(method_of_answers, minlength=len(tables.methods))
    return [
        {
            "method": method,
            "label": METHODS.get(method, method),
            "answers": int(counts[n]),
            **_named(name, found.own[n]),
            **_named("less_reference", found.less_reference[n]),
        }
        for n, method in enumerate(tables.methods)
    ]


def _named(name: str, figure: Figure | None) -> Row:
    """Return a figure and its interval as `name` and `name`_95; None: both are None."""
    if figure is None:
        return {name: None, f"{name}_95": None}
    ends = None if figure.low is None else [_number(figure.low), _number(figure.high or 0.0)]
    return {name: _number(figure.value), f"{name}_95": ends}


def _number(value: float) -> float | None:
    """Return a value rounded for JSON; None for NaN, which JSON does not have."""
    return None if np.isnan(value) else round(float(value), 4)


def machine_tables(path: Path, study: Study, key: Key) -> dict[str, Tables]:
    """Return what each machine reader read as tables, by reader; empty if the file is missing.

    Each sentence counts as a rater, since a machine always reads alike: so intervals are over
    sentences alone. Raises StudyError for a file that is not one of `study make`.
    """
    if not path.exists():
        return {}
    try:
        records = [json.loads(line) for line in path.read_bytes().splitlines()]
        readers = dict.fromkeys(record["reader"] for record in records)
        found = {}
        for reader in readers:
            of_reader = [r for r in records if r["reader"] == reader]
            sentences = dict.fromkeys(key.clips[r["clip"]].sentence for r in of_reader)
            clips_of = {
                s: [r for r in of_reader if key.clips[r["clip"]].sentence == s] for s in sentences
            }
            found[f"reader of {reader}"] = _tables_of_reader(study, key, clips_of)
    except (ValueError, KeyError, TypeError) as error:
        raise StudyError(f"{path}: is no file of `study make`; make the study anew") from error
    return found


def _tables_of_reader(
    study: Study, key: Key, clips_of: Mapping[str, Sequence[Mapping[str, str]]]
) -> Tables:
    """Return the answers of one machine reader as tables, as if each sheet were a rater's.

    clips_of: for each of its sheets the clips read, with keys `clip` and `answer`.
    """
    sheets = [tuple(Item("reading", (r["clip"],)) for r in each) for each in clips_of.values()]
    raters = {
        name: RaterRecord(n, {i: {"answer": r["answer"]} for i, r in enumerate(each)})
        for n, (name, each) in enumerate(clips_of.items())
    }
    return tables_of(replace(study, sheets=tuple(sheets)), key, raters)
