"""Budgets of code lines, objects that are whole when made, and the options of every bench."""

import subprocess
import sys

import pytest
import typer
import yaml
from lipservo_lab.bench.house.code_lines import (
    budgets,
    code_lines,
    house_table,
    room_lines,
    sources,
)
from lipservo_lab.bench.house.installed import installed_mb
from lipservo_lab.commands.groups import bench
from places import DATA, ROOT
from whole_objects import SourceTree, late_attributes, mixin_bases
from word_figures import word_figures

BENCHES = yaml.safe_load((DATA / "bench_options.yaml").read_text())


@pytest.fixture(scope="module")
def lines():
    return room_lines(ROOT)


@pytest.fixture(scope="module")
def tree():
    return SourceTree(ROOT)


@pytest.mark.parametrize("room", budgets())
def test_a_room_keeps_to_its_budget(room, lines):
    """A ceiling falls with the code, and never rises."""
    spare = budgets()[room].ceiling - lines[room]

    assert 0 <= spare < 200


def test_documenting_costs_nothing():
    plain = "def f(a):\n    return (\n        a\n    )\n"
    told = plain.replace("):\n", '):\n    """Say.\n\n    More.\n    """\n')

    assert code_lines(plain) == code_lines(f'"""Module."""\n\n# Of f.\n{told}') == 4


def test_every_folder_of_ours_is_counted_and_no_built_copy(tmp_path):
    ours = ("lipservo/commands/build/a.py", "client/lipservo_client/b.py")
    for name in (*ours, "client/build/lib/b.py", "client/tests/c.py", "client/.venv/d.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("a = 1\n")
    found = [path for folder in ("lipservo", "client") for path in sources(tmp_path, folder)]

    assert [path.relative_to(tmp_path).as_posix() for path in found] == list(ours)
    assert set(sources(ROOT, "lipservo")) >= set((ROOT / "lipservo/commands/build").glob("*.py"))


def test_no_class_has_its_other_half_in_a_neighbour_file(tree):
    assert mixin_bases(tree) == []


def test_objects_are_whole_when_made(tree):
    assert late_attributes(tree) == []


def test_what_is_unfinished_is_found(tmp_path):
    for folder in ("calibration", "firmware_bridge", "lipservo", "lipsync", "client", "lab"):
        (tmp_path / folder).mkdir()
    (tmp_path / "lipsync" / "half.py").write_text("class Half:\n    def __init__(self, a): ...\n")
    (tmp_path / "lipsync" / "whole.py").write_text(
        "from lipsync.half import Half\n"
        "class Whole(Half):\n    pass\n"
        "def made() -> Whole:\n    return Whole(1)\n"
        "def wired(whole: Whole | None):\n"
        "    other = made()\n    other.b = 1\n    other.a = 2\n    whole.c = 3\n"
    )
    tree = SourceTree(tmp_path)

    assert mixin_bases(tree) == ["lipsync/whole.py:2 Whole(Half)"]
    assert late_attributes(tree) == ["lipsync/whole.py:10 whole.c", "lipsync/whole.py:8 other.b"]


def options(command):
    """The names of the options and arguments of a command of click's."""
    return {
        name
        for each in command.params
        for name in (
            [*each.opts, *each.secondary_opts] if each.param_type_name == "option" else [each.name]
        )
    }


def test_every_bench_of_before_takes_what_it_took():
    group = typer.main.get_group(bench)
    found = {name: group.get_command(None, name) for name in group.list_commands(None)}

    assert set(BENCHES) <= set(found)
    missing = {name: set(told) - options(found[name]) for name, told in BENCHES.items()}
    assert {name: each for name, each in missing.items() if each} == {}


def test_a_tick_is_counted_between_two_waits_of_its_clock(tmp_path):
    for package, text in {
        "firmware_bridge/clock.py": "def sleep_until():\n    pass\n",
        "lipsync/b.py": "def g():\n    h()\ndef h():\n    pass\n",
        "lipsync/a.py": (
            "from firmware_bridge import clock\nfrom lipsync import b\n"
            "def run():\n    for _ in range(3):\n        clock.sleep_until()\n        f()\n"
            "def f():\n    b.g()\n"
        ),
    }.items():
        path = tmp_path / package
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    script = (
        f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT / 'lab')!r}]\n"
        "from lipservo_lab.bench.house.traced_ticks import TickTracer\n"
        f"from lipsync.a import run\ntracer = TickTracer({str(tmp_path)!r})\n"
        "sys.setprofile(tracer.profile)\nrun()\nsys.setprofile(None)\n"
        "print(tracer.n_files, tracer.n_hops)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path
    )

    assert done.stdout.strip() == "[2, 2] [1, 1]"


def test_words_links_and_figures_that_a_page_should_not_have_are_found(tmp_path):
    for file, text in {
        "README.md": "# A\n\n![b](c.png)\n\n**One two.** 95 ms, 12 %, `7 mm`; [d](docs/e.md#f).\n",
        "docs/benchmarks.md": "# F\n\n| 95 ms | `docs/gone.md` | [x](#f) | [y](#g) |\n",
        "lipsync/a.py": (
            '"""Nobody took it."""\n\n\ndef said(n_told: int, retold: int) -> None:\n    ...\n\n\n'
            'def bare(x: Array) -> Array:\n    """Return x."""\n\n\n'
            "def whole(x: Array) -> Array:\n"
            '    """Return x.\n\n    Parameters\n    ----------\n    x : (n, 3), mm\n    """\n'
        ),
    }.items():
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text(text)
    found = word_figures(tmp_path)

    assert found["dialect_names"] == ["lipsync/a.py:4 said", "lipsync/a.py:4 n_told"]
    assert found["dialect_docstrings"] == ["lipsync/a.py:1 nobody", "lipsync/a.py:1 took"]
    assert (found["array_functions"], found["array_docstrings"]) == (2, 0.5)
    assert found["array_docstrings_missing"] == ["lipsync/a.py:8 bare"]
    assert found["pages"] == {
        "readme_words": 12,
        "readme_first_sentence_words": 2,
        "docs_words": 12,
        "dead_links": ["README.md: c.png", "README.md: docs/e.md#f", "docs/benchmarks.md: #g"],
        "dead_paths": ["docs/benchmarks.md: docs/gone.md"],
        "readme_figures_unmeasured": ["12 %"],
    }


def test_pages_and_docstrings_keep_to_their_bars():
    """One name may stay: `hears` of the status is public."""
    found = word_figures(ROOT)
    pages = found["pages"]

    assert pages["readme_words"] <= 700
    assert pages["readme_first_sentence_words"] <= 15
    assert pages["docs_words"] <= 30_000
    assert pages["readme_figures_unmeasured"] == []
    assert len(found["dialect_names"]) <= 1, found["dialect_names"]
    assert len(found["dialect_docstrings"]) <= 20, found["dialect_docstrings"]
    assert found["array_docstrings"] >= 0.95, found["array_docstrings_missing"]


def test_an_installation_without_extras_is_small():
    """What a running face does not load is an extra: docs/decisions/dependencies.md."""
    sizes = [installed_mb(ROOT, each) for each in ("lipservo-client", "lipservo", "lipservo[fit]")]
    assert 1.0 < sizes[0] < 5.0
    assert sizes[1] < house_table()["installed_mb"]["lipservo"] < sizes[2]
