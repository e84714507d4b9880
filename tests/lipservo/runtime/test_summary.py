"""The table at the end of a run: what each figure means."""

import io
from dataclasses import fields

from rich.console import Console

from lipservo.runtime.summary import Summary, print_summary


def printed(**changes: object) -> str:
    none: dict[str, object] = {"joints_at_limit": {}, "joints_held_back": {}}
    figures = {field.name: 0 for field in fields(Summary)} | none
    screen = io.StringIO()
    console = Console(file=screen, width=80, markup=False, emoji=False, highlight=False)
    print_summary(Summary(**(figures | {"source": "[final].wav"} | changes)), console)
    return screen.getvalue()


def test_every_figure_has_a_line_of_its_own_and_a_meaning_in_80_columns():
    title, *lines = printed().splitlines()
    assert title.strip() == "[final].wav"
    assert len(lines) == len(fields(Summary)) - 4  # title; joints and lips come below
    for line in lines:
        name, *_, meaning = [part for part in line.split("  ") if part.strip()]
        assert name.strip()
        assert len(meaning.split()) >= 2


def test_joints_that_often_stand_at_a_limit_are_named():
    assert "lip_protrusion stood at a limit in 24% of the frames" in printed(
        joints_at_limit={"lip_protrusion": 0.24}
    )


def test_joints_that_are_too_slow_are_named_with_a_remedy():
    text = printed(joints_held_back={"jaw": 0.18}).replace("\n", " ")

    assert "jaw was too slow for 18% of the motion" in text
    assert "max_speed_deg_s" in text
