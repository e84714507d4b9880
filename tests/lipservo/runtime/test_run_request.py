"""The request that goes whole to the processes of a face: nothing falls out, nothing slips in."""

import json
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT

from lipservo.runtime.motion_options import MotionOptions
from lipservo.runtime.run_request import (
    CLIP,
    AvatarTargets,
    RequestError,
    RunRequest,
    Sound,
    VoiceOptions,
    request_json,
    request_of_json,
)
from lipservo.settings.motion_names import STRATEGIES
from lipsync.motion.finishing import LONGEST_LOOKAHEAD_S, STRONGEST, Style
from lipsync.plugins import RECOGNIZERS

HELD_OUT = str(ROOT / "benchmarks" / "recognizer_held_out.npz")
#: Names of files need not be UTF-8: Python keeps such a byte as a lone surrogate.
names = st.text(st.characters(exclude_characters="\0"), min_size=1) | st.just("a\udcff b.wav")
paths = st.builds(Path, names)
styles = st.builds(
    Style,
    lookahead_s=st.floats(0.0, LONGEST_LOOKAHEAD_S),
    strength=st.floats(0.0, STRONGEST),
    unit_share=st.floats(0.0, 1.0),
    smoothness=st.floats(0.0, 1.0),
)
motions = st.builds(
    MotionOptions,
    engine=st.sampled_from(list(RECOGNIZERS.built_in)),
    weights=st.sampled_from(["default", "grid", HELD_OUT]),
    strategy=st.sampled_from(STRATEGIES),
    style=styles,
)
heard_sounds = st.builds(Sound, st.sampled_from(["clip", "file", "microphone", "silence"]), names)
spoken_sounds = st.builds(Sound, st.just("text"), names, language=st.just("") | names) | st.builds(
    Sound, st.just("file"), names, phonemes=st.just("") | names
)
voices = st.builds(
    VoiceOptions,
    output=st.none() | names,
    token_file=st.none() | names,
    sounds=st.none() | names,
)
addresses = st.sampled_from(["127.0.0.1", "avatar.local:39540"])
requests = st.builds(
    lambda sound_and_voice, **rest: RunRequest(
        sound=sound_and_voice[0], voice=sound_and_voice[1], **rest
    ),
    st.tuples(heard_sounds, st.none() | voices) | st.tuples(spoken_sounds, voices),
    config=names,
    motion=motions,
    model=st.none() | paths,
    port=st.none() | names,
    rate_hz=st.none() | st.floats(30.0, 200.0),
    trace=st.none() | paths,
    control=st.none() | paths,
    as_json=st.booleans(),
    quiet=st.booleans(),
    dry_run=st.booleans(),
    avatars=st.builds(AvatarTargets, st.none() | addresses, st.none() | addresses),
    servos=names,
)
WHOLE = json.loads(request_json(RunRequest("face_sim", CLIP)))


@settings(max_examples=60)  # weights that are named are read
@given(requests)
def test_what_is_written_for_another_process_is_read_as_it_was(request):
    text = request_json(request)

    assert request_of_json(text) == request
    assert "\n" not in text


@pytest.mark.parametrize("name", [field.name for field in fields(RunRequest)])
def test_a_request_without_a_field_is_refused(name):
    part = {key: value for key, value in WHOLE.items() if key != name}
    why = "Field required" if name in ("config", "sound") else "is missing"

    with pytest.raises(RequestError, match=rf"^request\.{name}: {why}"):
        request_of_json(json.dumps(part))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"volume": 1}, "request.volume: Unexpected"),
        ({"rate_hz": "fast"}, "request.rate_hz: Input should be a valid number"),
        ({"rate_hz": "30"}, "request.rate_hz: '30' is not a number"),
        (
            {"rate_hz": True},
            "request: --rate-hz 1 is outside the possible 30 to 200 ticks per second",
        ),
        (
            {"rate_hz": float("nan")},
            "request: --rate-hz nan is outside the possible 30 to 200 ticks",
        ),
        ({"quiet": 3}, "request.quiet: Input should be a valid boolean"),
        ({"quiet": 1}, "request.quiet: 1 is not true or false"),
        ({"quiet": "yes"}, "request.quiet: 'yes' is not true or false"),
        ({"config": None}, "request.config: Input should be a valid string, not None"),
        ({"model": 3}, "request.model: Input is not a valid path"),
        ({"sound": {"name": "a.wav"}}, "request.sound.kind: Field required"),
        ({"sound": {**WHOLE["sound"], "kind": "noise"}}, "request.sound.kind: Input should be "),
        (
            {"sound": {**WHOLE["sound"], "phonemes": "a"}},
            "request.sound: --phonemes needs --wav",
        ),
        ({"sound": {**WHOLE["sound"], "kind": "text", "name": "Hi"}}, "request: Hi: a text, or"),
        ({"voice": {"volume": 1}}, "request.voice.volume: Unexpected"),
        ({"voice": {"output": None, "sounds": None}}, "request.voice.token_file: is missing"),
        ({"motion": {**WHOLE["motion"], "style": {}}}, "request.motion.style.lookahead_s: is miss"),
        (
            {"motion": {**WHOLE["motion"], "engine": "ears"}},
            "request.motion: recogniser 'ears' is",
        ),
        (
            {"motion": {**WHOLE["motion"], "recognizer_latency_s": 60.0}},
            "request.motion: recognizer_latency_s is 60.0; allowed: above 0 to 1.0",
        ),
        (
            {
                "sound": {**WHOLE["sound"], "kind": "file", "text": "Hi."},
                "motion": {**WHOLE["motion"], "engine": "energy"},
            },
            "request: recogniser energy follows no text; leave --text out",
        ),
    ],
)
def test_a_wrong_field_is_refused_in_one_line_that_names_it(change, said):
    with pytest.raises(RequestError) as refused:
        request_of_json(json.dumps({**WHOLE, **change}))

    assert str(refused.value).startswith(said)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "null", "[" * 100_000])
def test_what_is_no_request_at_all_is_refused(text):
    with pytest.raises(RequestError, match=r"^request: "):
        request_of_json(text)
