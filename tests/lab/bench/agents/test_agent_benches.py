"""Samples of `lipservo bench agent` and `bench day`; whole in the campaign."""

import gc
import shutil
import warnings
from importlib import import_module

import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its own imports warn of what it will drop one day
    pytest.importorskip("pipecat", reason="make agents")
    from lipservo_lab.bench.agents.agent_figures import agent_figures
    from lipservo_lab.bench.agents.day_figures import EVENTS, day_figures

pytestmark = pytest.mark.filterwarnings("ignore")
needs_pulseaudio = pytest.mark.skipif(shutil.which("pulseaudio") is None, reason="no pulseaudio")


def silent(*_):
    """No progress is shown."""


@pytest.mark.parametrize("framework", ["pipecat", "livekit", "openai", "wyoming"])
def test_an_agent_that_is_interrupted_remembers_what_was_heard(framework):
    """A restart and an absent face are among the turns."""
    name = f"{framework}_agent"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        speaks = getattr(import_module(f"lipservo_lab.bench.agents.{name}"), name)
    figures = agent_figures(speaks, 18, 9, silent)
    gc.collect()  # frameworks leave closed connections to it

    assert (figures["unheard_words"], figures["forgotten_words"]) == (0, 0)
    assert figures["streams_refused"] == 0
    assert (figures["double_voice_s"], figures["mute_turns"]) == (0.0, 0)


def check_day(figures):
    assert figures["mute_turns"] == figures["hung_turns"] == 0
    assert figures["gone_noticed_s"] <= 10.0
    assert figures["rss_growth_mb"] <= 5.0
    assert figures["threads_growth"] == 0


@needs_pulseaudio
@pytest.mark.slow
def test_an_agent_speaks_after_a_load_a_restart_and_a_pulled_cable():
    events = {"load": 1, "daemon restart": 1, "cable pulled": 1}

    figures = day_figures(1.5, events, silent)
    assert figures["turns"] >= 5
    check_day(figures)


@needs_pulseaudio
@pytest.mark.campaign
def test_an_agent_speaks_all_day():
    figures = day_figures(12.0, EVENTS, silent)

    assert figures["turns"] >= 50
    check_day(figures)
