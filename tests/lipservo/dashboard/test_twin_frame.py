"""The binary frame: read back by an independent reader, and by the page's own JavaScript."""

import json
import os
import shutil
import struct
import subprocess

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import ROOT
from watched_face import LAYOUT

from lipservo.dashboard.live_frames import (
    FIELDS,
    Snapshot,
    encode,
    hello,
    state_hello,
    state_message,
)
from lipservo.runtime.status.live_board import EXPRESSION_NAMES

N = len(LAYOUT.servos)
M = len(EXPRESSION_NAMES)
FLOATS = st.floats(-200.0, 200.0) | st.just(float("nan"))


def record(kind, **values):
    made = np.zeros((), kind)
    for name, value in values.items():
        made[name] = value
    return made


def servos(**values):
    return record(LAYOUT.servo_type(), **{"state": 1, "torque_on": 1, **values})


def speech(**values):
    return record(LAYOUT.speech_type(), **{"phoneme": 2, "is_speech": 1, **values})


def snapshot(peaks=b"", **values):
    about = {"servos": servos(), "speech": speech(), "servos_gone": False, "speech_gone": False}
    return Snapshot(7, 1.5, **{**about, **values}, peaks=peaks)


def read(frame):
    """As the contract words it."""
    n, time_s, state, phoneme, flags, arousal = struct.unpack_from("<IfBBBb", frame)
    shape = f"<{LAYOUT.n_components}f{M}h{N}h{N}hB"
    values = struct.unpack_from(shape, frame, 12)
    k = LAYOUT.n_components
    peaks = frame[12 + struct.calcsize(shape) :]
    assert values[-1] == len(peaks)
    return {
        "n": n, "time_s": time_s, "state": state, "phoneme": phoneme, "flags": flags,
        "arousal": arousal, "coefficients": values[:k], "expression": values[k : k + M],
        "goals": values[k + M : k + M + N], "encoders": values[k + M + N : -1], "peaks": peaks,
    }  # fmt: skip


@given(
    st.lists(FLOATS, min_size=N, max_size=N),
    st.lists(FLOATS, min_size=N, max_size=N),
    st.lists(FLOATS, min_size=M, max_size=M),
    st.binary(max_size=8),
)
def test_a_frame_says_what_the_face_does(goals, encoders, expression, peaks):
    frame = read(
        encode(
            snapshot(
                servos=servos(goal_deg=goals, encoder_deg=encoders),
                speech=speech(expression=expression, arousal=-0.5, coefficients=np.arange(8)),
                peaks=peaks,
            ),
            LAYOUT,
        )
    )

    assert (frame["n"], frame["time_s"], frame["state"], frame["phoneme"]) == (7, 1.5, 1, 2)
    assert (frame["flags"], frame["arousal"], frame["peaks"]) == (1 | 16, -64, peaks)
    assert frame["coefficients"] == tuple(range(8))
    for told, meant in ((frame["goals"], goals), (frame["encoders"], encoders)):
        for raw, angle in zip(told, meant, strict=True):
            assert (raw == -32768) == np.isnan(angle)
            assert raw == -32768 or abs(raw / 100 - angle) < 0.0051
    for raw, value, name in zip(frame["expression"], expression, EXPRESSION_NAMES, strict=True):
        scale, most = (100, 327.67) if name.endswith("_deg") else (1e4, 3.2767)
        if np.isnan(value):
            assert raw == -32768
        else:
            assert abs(raw / scale - np.clip(value, -most, most)) <= 0.51 / scale


def test_what_is_gone_is_not_told_as_if_it_were_there():
    frame = read(encode(snapshot(servos_gone=True, speech_gone=True), LAYOUT))

    assert frame["flags"] == 2 | 4
    assert (frame["state"], frame["phoneme"]) == (255, 255)
    assert set(frame["encoders"]) == {-32768}
    assert set(frame["expression"]) == {-32768}


def test_before_anything_was_heard_nothing_is_known():
    frame = read(encode(Snapshot(0, 0.0), LAYOUT))
    assert set(frame["goals"]) == set(frame["encoders"]) == {-32768}


def test_both_streams_take_less_than_8_kb_a_second():
    far = snapshot(
        servos=servos(goal_deg=[-123.4] * N, encoder_deg=[-123.4] * N),
        speech=speech(expression=[-60.0] * M),
        peaks=bytes(8),
    )
    assert 30 * len(encode(far, LAYOUT)) < 8000
    assert 30 * len(state_message(far, LAYOUT)) < 8000


def test_the_json_says_the_same():
    told = json.loads(
        state_message(
            snapshot(servos=servos(goal_deg=[1.26] * N, encoder_deg=[np.nan] * N)), LAYOUT
        )
    )
    named = dict(zip(json.loads(state_hello(LAYOUT))["fields"], told, strict=True))

    assert list(named) == list(FIELDS)
    assert named["goals_tenths_deg"] == [13] * N
    assert named["encoders_tenths_deg"] == [None] * N
    assert named["time_ms"] == 1500
    gone = json.loads(state_message(snapshot(servos_gone=True), LAYOUT))
    assert gone[2] is None


@pytest.mark.skipif(shutil.which("node") is None, reason="no node")
def test_the_page_reads_what_was_written(tmp_path):
    """`decode` of static/frame.js, run by node."""
    goals = np.linspace(-90.0, 90.0, N)
    encoders = [np.nan, *goals[1:]]
    expression = [12.5, np.nan, *[0.25] * (M - 2)]
    frame = encode(
        snapshot(
            servos=servos(goal_deg=goals, encoder_deg=encoders),
            speech=speech(
                expression=expression, arousal=1.0, coefficients=np.linspace(0, 1, 8), is_cut_off=1
            ),
            peaks=bytes([0, 51, 255]),
        ),
        LAYOUT,
    )
    script = tmp_path / "read.mjs"
    script.write_text(
        f"import {{ decode }} from '{ROOT}/lipservo/dashboard/static/frame.js';\n"
        f"const bytes = new Uint8Array({list(frame)});\n"
        f"const frame = decode(bytes.buffer, {hello(LAYOUT)});\n"
        "frame.coefficients = Array.from(frame.coefficients);\n"
        "console.log(JSON.stringify(frame));"
    )
    environment = {**os.environ, "NODE_NO_WARNINGS": "1"}
    done = subprocess.run(
        ["node", script], capture_output=True, text=True, check=True, env=environment
    )
    told = json.loads(done.stdout)

    assert (told["n"], told["timeS"], told["state"]) == (7, 1.5, "driven")
    assert told["phoneme"] == LAYOUT.phonemes[2]
    flags = {"torqueOn": True, "servosGone": False, "speechGone": False, "cutOff": True}
    assert {name: told[name] for name in flags} == flags
    assert told["speaking"] is True
    assert told["arousal"] == 1.0
    assert told["goalsDeg"] == pytest.approx(goals, abs=0.005)
    assert told["encodersDeg"][0] is None
    assert told["encodersDeg"][1:] == pytest.approx(goals[1:], abs=0.005)
    assert told["coefficients"] == pytest.approx(np.linspace(0, 1, 8), abs=1e-6)
    named = dict(zip(EXPRESSION_NAMES, expression, strict=True))
    assert told["expression"]["neck_pitch_deg"] == 12.5
    assert told["expression"]["neck_yaw_deg"] is None
    assert told["expression"]["smile"] == named["smile"]
    assert told["peaks"] == [0.0, 0.2, 1.0]
