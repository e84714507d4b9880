"""The request that goes whole to the processes of a face: nothing falls out, nothing slips in."""

import json
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
from lipservo.settings.motion_names import ENGINES, STRATEGIES
from lipsync.motion.live_synthesizer import LONGEST_LOOKAHEAD_S, STRONGEST, Style

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
    engine=st.sampled_from(ENGINES),
    weights=st.sampled_from(["default", "grid", HELD_OUT]),
    strategy=st.sampled_from(STRATEGIES),
    style=styles,
)
sounds = st.builds(
    Sound,
    st.sampled_from(["clip", "file", "microphone", "silence", "text"]),
    names,
    language=st.just("") | names,
    phonemes=st.just("") | names,
)
voices = st.builds(
    VoiceOptions,
    output=st.none() | names,
    token_file=st.none() | names,
    sounds=st.none() | names,
)
addresses = st.sampled_from(["127.0.0.1", "avatar.local:39539"])
requests = st.builds(
    RunRequest,
    config=names,
    sound=sounds,
    motion=motions,
    model=st.none() | paths,
    port=st.none() | names,
    rate_hz=st.none() | st.floats(30.0, 200.0),
    trace=st.none() | paths,
    control=st.none() | paths,
    as_json=st.booleans(),
    quiet=st.booleans(),
    dry_run=st.booleans(),
    voice=st.none() | voices,
    avatars=st.builds(AvatarTargets, st.none() | addresses, st.none() | addresses),
)
WHOLE = json.loads(request_json(RunRequest("face_sim", CLIP)))


@settings(max_examples=60)  # weights that are named are read
@given(requests)
def test_what_is_written_for_another_process_is_read_as_it_was(request):
    text = request_json(request)

    assert request_of_json(text) == request
    assert "\n" not in text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"volume": 1}, "request.volume: Unexpected"),
        ({"rate_hz": "fast"}, "request.rate_hz: Input should be a valid number"),
        ({"quiet": 3}, "request.quiet: Input should be a valid boolean"),
        ({"config": None}, "request.config: Input should be a valid string, not None"),
        ({"model": 3}, "request.model: Input is not a valid path"),
        ({"sound": {"name": "a.wav"}}, "request.sound.kind: Field required"),
        ({"sound": {**WHOLE["sound"], "kind": "noise"}}, "request.sound.kind: Input should be "),
        ({"voice": {"volume": 1}}, "request.voice.volume: Unexpected"),
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
