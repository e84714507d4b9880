"""The examples of voice agents speak through a real server; only the face's clock is made up."""

import base64
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from places import ROOT
from voice_agents.served_face import RATE_HZ, ServedFace, tone, until

from lipservo.agents.listener import AgentSettings


@pytest.fixture
def face():
    with ServedFace() as served:
        yield served


def run(name, *arguments):
    """What an example prints; it must end well and say nothing on stderr."""
    command = [sys.executable, ROOT / "examples" / name, *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def sounding_s(face):
    return np.count_nonzero(face.sound.played()) / RATE_HZ


def test_a_synthesiser_is_heard_to_the_end(face):
    printed = run("speak_with_tts.py", "Good morning.", face.url)

    played_s = float(re.fullmatch(r"heard (\d\.\d\d) s, to the end\n", printed)[1])
    assert 0.5 < played_s < 2.5
    assert sounding_s(face) > 0.4


def test_an_agent_learns_how_much_was_heard_when_a_person_breaks_in(face):
    printed = run("voice_agent.py", face.url)

    found = re.fullmatch(r"heard (\d+\.\d\d) s, (\d+\.\d\d) s were never heard\n", printed)
    heard_s, dropped_s = map(float, found.groups())
    assert 0.5 < heard_s < 9.0
    assert dropped_s > 0.0
    assert sounding_s(face) == pytest.approx(heard_s, abs=0.06)


def test_frames_of_a_track_are_heard_in_one_channel(face):
    assert run("livekit_audio.py", face.url) == "heard 0.50 s, to the end\n"
    assert np.abs(face.sound.played()).max() == pytest.approx(8_000 / 32_768, rel=0.02)


def deltas(item, pcm, name="response.output_audio.delta"):
    """As the API's reference shows them."""
    about = {"response_id": "resp_1", "item_id": item, "output_index": 0, "content_index": 0}
    for number, first in enumerate(range(0, len(pcm), 4_801)):  # cut in the middle of samples
        delta = base64.b64encode(pcm[first : first + 4_801]).decode()
        yield {"event_id": f"event_{number}", "type": name, **about, "delta": delta}
    done = name.replace("delta", "done")
    yield {"event_id": "event_done", "type": done, **about}


@pytest.mark.parametrize("name", ["response.output_audio.delta", "response.audio.delta"])
def test_the_audio_of_a_realtime_session_is_heard(face, tmp_path, name):
    events = [{"type": "session.created"}, *deltas("item_1", tone(0.4), name)]
    (tmp_path / "events.jsonl").write_text("\n".join(map(json.dumps, events)))

    assert run("openai_realtime.py", tmp_path / "events.jsonl", face.url) == ""

    until(lambda: face.playout.is_over)
    assert sounding_s(face) == pytest.approx(0.4, abs=0.02)


def test_the_transcript_of_a_realtime_session_is_told_in_whole_words(tmp_path):
    *spoken, done = deltas("item_1", tone(4.0))
    about = {"type": "response.output_audio_transcript.delta", "item_id": "item_1"}
    pieces = [
        {**about, "content_index": 0, "delta": text} for text in ("Good mor", "ning, a", "ll")
    ]
    over = {**about, "type": "response.output_audio_transcript.done", "content_index": 0}
    events = [*pieces[:1], *spoken, pieces[1], done, pieces[2], over]
    (tmp_path / "events.jsonl").write_text("\n".join(map(json.dumps, events)))
    with ServedFace(step_s=0.001) as face:
        run("openai_realtime.py", tmp_path / "events.jsonl", face.url)
        words: list[str] = []

        def has_all():
            words.extend(w.label for each in face.playout.take_words() for w in each.words)
            return words[:3] == ["Good", "morning", "all"]

        until(has_all)


def test_a_barge_in_truncates_the_item_to_what_was_heard(tmp_path):
    # Positions are not told, so that nothing but the session's events drives the example.
    with ServedFace(AgentSettings(position_s=3600.0)) as face:
        *spoken, done = deltas("item_7", tone(40.0))
        events = [*spoken, done, {"type": "input_audio_buffer.speech_started", "audio_start_ms": 9}]
        (tmp_path / "events.jsonl").write_text("\n".join(map(json.dumps, events)))

        printed = run("openai_realtime.py", tmp_path / "events.jsonl", face.url)
        heard_ms = 1e3 * sounding_s(face)

    answer = json.loads(printed)
    assert answer["type"] == "conversation.item.truncate"
    assert (answer["item_id"], answer["content_index"]) == ("item_7", 0)
    assert 0 <= answer["audio_end_ms"] < 40_000
    assert answer["audio_end_ms"] == pytest.approx(heard_ms, abs=60)
