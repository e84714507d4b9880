"""How sound becomes motion: what is typed goes before the face's YAML, and that before defaults."""

from dataclasses import fields

import pytest
import typer
import yaml
from places import ROOT

from lipservo.commands.run.motion_choice import takes_motion
from lipservo.runtime.motion_options import (
    LOW_LATENCY_LOOKAHEAD_S,
    LOW_LATENCY_S,
    ChosenMotion,
    MotionOptions,
    motion_options,
)
from lipservo.settings import motion_names as names
from lipservo.settings.motion_names import STRATEGIES as NAMES
from lipservo.settings.motion_names import STYLE_NAMES
from lipservo.settings.sections import MotionSettings
from lipservo.settings.settings import parse_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.animpho.selection import STRATEGIES
from lipsync.errors import UserError
from lipsync.motion.finishing import LONGEST_LOOKAHEAD_S, STRONGEST, Style
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, UNIT_STRATEGY
from lipsync.plugins import RECOGNIZERS
from lipsync.recognition.recognizers import make_recognizer

FACE = yaml.safe_load((ROOT / "config" / "face_sim.yaml").read_text())
TYPED = {
    "engine": "energy",
    "weights": "grid",
    "strategy": "animpho",
    "lookahead_ms": 50.0,
    "strength": 0.5,
    "smoothness": 0.25,
    "unit_share": 0.75,
}


def face_with(motion):
    return parse_face(yaml.safe_dump({**FACE, "motion": motion}), "face.yaml").motion


@pytest.mark.parametrize("name", [field.name for field in fields(ChosenMotion)])
def test_every_option_reaches_the_command_that_takes_them(name):
    heard = []

    @takes_motion
    def command(*, motion: ChosenMotion) -> None:
        heard.append(motion)

    app = typer.Typer()
    app.command()(command)
    option = f"--{name.replace('_', '-')}"
    value = TYPED.get(name, True)
    app([option] if value is True else [option, str(value)], standalone_mode=False)

    assert heard == [ChosenMotion(**{name: value})]


OTHER = {"engine": "network", "weights": "default", "lookahead_ms": 80, "strength": 1.5}


@pytest.mark.parametrize(
    ("typed", "written"), [({}, TYPED), (TYPED, {**OTHER, "smoothness": 1})], ids=["yaml", "typed"]
)
def test_what_is_typed_goes_before_the_yaml_which_is_used_where_nothing_is(typed, written):
    options = motion_options(ChosenMotion(**typed), face_with(written), None)

    assert options == MotionOptions("energy", "grid", "animpho", Style(0.05, 0.5, 0.25, 0.75))


def test_a_drawn_face_is_on_stage_unless_the_yaml_says_otherwise():
    drawn = motion_options(ChosenMotion(), face_with({}), None, stage=1.0)
    as_recorded = motion_options(ChosenMotion(), face_with({"stage": 0.0}), None, stage=1.0)

    assert (drawn.style.stage, as_recorded.style.stage) == (1.0, 0.0)


def test_another_strategy_than_the_yamls_leaves_aside_what_it_has_not():
    written = face_with({"strength": 0.5, "smoothness": 0.5})
    options = motion_options(ChosenMotion(strategy="naive"), written, None)

    assert options == MotionOptions(strategy="naive", style=Style(strength=0.5))
    assert options.style_settings == {"strength": 0.5, "stage": 0.0}
    assert list(options.live_settings()) == ["strength", "stage"]


@pytest.mark.parametrize(
    ("strategy", "name"),
    [(each, n) for each in NAMES for n in STYLE_NAMES if n not in names.STYLES_OF[each]],
)
def test_what_a_strategy_ignores_is_refused_typed_or_written(strategy, name):
    option = f"--{name.replace('_', '-')}"

    with pytest.raises(UserError, match=rf"^{option}: strategy {strategy} ignores it"):
        motion_options(ChosenMotion(strategy=strategy, **{name: 0.0}), MotionSettings(), None)
    with pytest.raises(UserError, match=rf"^{option}: strategy {strategy} ignores it"):
        motion_options(ChosenMotion(**{name: 0.0}), MotionSettings(strategy=strategy), None)
    with pytest.raises(SettingsError, match=f"strategy {strategy} has no {name}"):
        face_with({"strategy": strategy, name: 0.0})


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ({"lookahead_ms": 50.0}, "--lookahead-ms"),
        ({"strategy": "naive"}, "--strategy naive"),
        ({"engine": "energy"}, "--engine energy"),
    ],
)
def test_low_latency_and_what_is_late_contradict_each_other(typed, said):
    with pytest.raises(UserError) as refused:
        motion_options(ChosenMotion(low_latency=True, **typed), MotionSettings(), None)
    assert str(refused.value) == f"--low-latency and {said} contradict each other; leave one out"


@pytest.mark.parametrize("written", [{"engine": "energy"}, {"strategy": "priority"}])
def test_low_latency_and_a_yaml_that_is_late_contradict_each_other(written):
    ((name, value),) = written.items()
    with pytest.raises(UserError, match=rf"and the face's `{name}: {value}` contradict"):
        motion_options(ChosenMotion(low_latency=True), face_with(written), None)
    typed = {name: getattr(MotionOptions(), name)}
    options = motion_options(ChosenMotion(low_latency=True, **typed), face_with(written), None)
    assert options.recognizer_latency_s == LOW_LATENCY_S


@pytest.mark.parametrize("written", [{}, {"lookahead_ms": 200.0, "strength": 0.5}])
def test_low_latency_goes_before_the_yaml(written):
    options = motion_options(ChosenMotion(low_latency=True), face_with(written), None)

    assert options.style == Style(LOW_LATENCY_LOOKAHEAD_S, written.get("strength", 1.0))
    assert options.recognizer_latency_s == LOW_LATENCY_S


def test_weights_of_a_yaml_are_found_from_its_folder(tmp_path):
    (tmp_path / "own.npz").write_bytes((ROOT / "benchmarks/recognizer_held_out.npz").read_bytes())

    options = motion_options(ChosenMotion(), face_with({"weights": "own.npz"}), tmp_path)

    assert options.weights == str(tmp_path / "own.npz")


def test_the_names_and_limits_that_load_at_once_are_those_of_what_they_name():
    assert set(NAMES) == {LIVE_STRATEGY, UNIT_STRATEGY, *STRATEGIES}
    for engine in RECOGNIZERS.built_in:
        assert make_recognizer(engine).level == engine
    MotionSettings(lookahead_ms=LONGEST_LOOKAHEAD_S * 1e3, strength=STRONGEST, smoothness=1.0)
    assert names.STRONGEST == STRONGEST
    assert names.LONGEST_LOOKAHEAD_MS == LONGEST_LOOKAHEAD_S * 1e3
    assert set(names.STYLES_OF) == set(NAMES)
    for beyond in ({"lookahead_ms": LONGEST_LOOKAHEAD_S * 1e3 + 1}, {"strength": STRONGEST + 0.01}):
        with pytest.raises(ValueError, match="outside"):
            MotionSettings(**beyond)
