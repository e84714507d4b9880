"""Time and memory of a command in a process of its own."""

import sys

import pytest
from lipservo_lab.bench.motion_figures import BenchError
from lipservo_lab.bench.offline_models import cost_of

#: Python alone takes some 10 MB.
HELD_MB = 150


def run(code):
    return cost_of([sys.executable, "-I", "-S", "-c", code])


def test_memory_is_what_the_command_held_at_most():
    cost = run(f"held = b'x' * {HELD_MB}_000_000; del held")

    assert HELD_MB < cost.build_mb < HELD_MB + 50
    assert cost.build_processor_s > 0.0
    assert cost.build_s > 0.0


def test_what_the_caller_holds_is_not_counted():
    held = b"x" * (HELD_MB * 1_000_000)

    assert run("pass").build_mb < 50 < len(held)


def test_a_command_that_fails_says_why():
    with pytest.raises(BenchError, match="the last word"):
        run("import sys; sys.exit('first\\nthe last word')")
