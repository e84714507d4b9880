"""The options of a manner, written out for another process and read back, lose nothing."""

import typer
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT

from lipservo.commands.run.motion_flags import manner_arguments, takes_manner
from lipservo.street.motion_options import Manner
from lipsync.motion.live_synthesizer import STRONGEST, Style

HELD_OUT = str(ROOT / "benchmarks" / "recognizer_held_out.npz")
styles = st.builds(
    Style,
    lookahead_s=st.integers(0, 1000).map(lambda ms: ms / 1e3),
    strength=st.floats(0.0, STRONGEST),
    smoothness=st.floats(0.0, 1.0),
)
manners = st.builds(
    Manner,
    engine=st.sampled_from(["network", "pocketsphinx"]),
    weights=st.sampled_from(["default", "grid", HELD_OUT]),
    strategy=st.sampled_from(["expected", "priority", "naive"]),
    style=styles,
)


@settings(max_examples=25)  # weights that are named are read
@given(manners)
def test_a_manner_survives_the_command_line_of_another_process(manner: Manner) -> None:
    heard: list[Manner] = []

    @takes_manner
    def command(*, manner: Manner) -> None:
        heard.append(manner)

    app = typer.Typer()
    app.command()(command)
    app(manner_arguments(manner), standalone_mode=False)
    assert heard[0].weights == manner.weights
    assert heard[0].engine == manner.engine
    assert heard[0].strategy == manner.strategy
    assert abs(heard[0].style.lookahead_s - manner.style.lookahead_s) < 1e-9
    assert heard[0].style.strength == manner.style.strength
    assert heard[0].style.smoothness == manner.style.smoothness
