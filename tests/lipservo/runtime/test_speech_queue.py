"""What a face says by itself: eight at most, one after the other, by one thread."""

import json
import threading
import time
from collections import deque
from contextlib import closing

import numpy as np
import pytest
import soundfile

from lipservo.runtime.sound import (
    QueueFullError,
    Speaker,
    SpeechItem,
    SpeechQueue,
    speaker_of,
    spoken_chunks,
    spoken_file,
    spoken_text,
)
from lipservo.settings.sections import SoundSettings
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.audio.source import SoundError
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.text_to_speech.synthesis import SynthesisError

RATE_HZ = 16_000
PATIENCE_S = 30.0


class Face:
    """A playout that is played as fast as it can."""

    def __init__(self):
        self.playout = Playout()
        self.now_s = 0.0

    def play(self, until, step_s=0.1):
        """Until something holds."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not until():
            assert time.monotonic() < give_up_s
            self.now_s += step_s
            self.playout.blocks(self.now_s)
            self.playout.advance(self.now_s)
            time.sleep(0.001)

    def finished(self):
        return [each.stream for each in self.playout.events if each.kind == "finished"]

    def ask(self, kind):
        self.playout.requests.append(PlayoutRequest(kind))


@pytest.fixture
def face():
    return Face()


@pytest.fixture
def queue(face):
    with closing(SpeechQueue(face.playout)) as queue:
        yield queue


def tone(duration_s):
    return np.full(round(duration_s * RATE_HZ), 0.3, np.float32)


def sound(face, name, *chunks):
    stream = PlayoutStream(name, RATE_HZ, face.playout.output_rate_hz)
    return spoken_chunks(iter(chunks), stream, sum(map(len, chunks)) / RATE_HZ)


def add(queue, face, name, *chunks):
    spoken = sound(face, name, *chunks)
    queue.add(spoken, name)
    return spoken


def text(face, words):
    return spoken_text(words, face.playout, Speaker("espeak"))


def settle(until):
    give_up_s = time.monotonic() + PATIENCE_S
    while not until():
        assert time.monotonic() < give_up_s
        time.sleep(0.005)


def test_a_ninth_is_refused_until_the_first_was_said_whatever_they_are(face, queue, tmp_path):
    soundfile.write(tmp_path / "line.wav", tone(0.2), RATE_HZ)
    for number in range(8):
        if number % 3 == 0:
            queue.add(text(face, "Good morning. And good night."), "text")
        elif number % 3 == 1:
            queue.add(spoken_file(tmp_path / "line.wav", face.playout), "line.wav")
        else:
            add(queue, face, "chunks", tone(0.2))

    refused = sound(face, "ninth", tone(0.2))
    for _ in range(3):
        with pytest.raises(QueueFullError, match="ninth: 8 texts, sounds or perform"):
            queue.add(refused, "ninth")
    face.play(lambda: face.finished().count("text") == 2)
    queue.add(refused, "ninth")
    face.play(lambda: face.playout.is_over)
    expected = ["text", "text", "line.wav", "chunks"]
    assert face.finished() == [*expected, *expected, *expected[:3], "ninth"]


def test_all_are_read_by_one_thread(face, queue):
    before = threading.active_count()
    for number in range(8):
        add(queue, face, str(number), *[tone(1.0)] * 20)
    assert threading.active_count() == before + 1


def test_of_those_that_wait_nothing_is_read(face, queue):
    first = add(queue, face, "first", *[tone(1.0)] * 60)
    second = add(queue, face, "second", *[tone(1.0)] * 60)
    settle(lambda: first.is_ahead)
    assert first.streams[0].waiting_s < 10.0
    assert second.streams[0].n_received == 0
    face.play(lambda: face.finished() == ["first", "second"])


def test_an_interruption_drops_all_that_came_before_it_and_nothing_after(face, queue):
    for name in "abc":
        add(queue, face, name, *[tone(1.0)] * 60)
    queue.add(text(face, "One. Two. Three. " * 40), "text")
    settle(lambda: face.playout.requests)
    face.ask("interrupt")
    add(queue, face, "after", tone(0.2))
    face.play(lambda: face.playout.is_over)
    assert face.finished() == ["after"]
    cut = [each.stream for each in face.playout.events if each.kind == "interrupted"]
    assert cut == ["a", "b", "c", "text"]
    for _ in range(8):
        add(queue, face, "again", tone(0.1))


def test_what_is_cleared_leaves_room(face, queue):
    for _ in range(8):
        add(queue, face, "long", *[tone(1.0)] * 60)
    face.ask("clear")
    face.play(lambda: face.playout.is_over)
    queue.check_room("next")


@pytest.mark.parametrize("error", [SoundError("disk: gone"), RuntimeError("a fault of ours")])
def test_one_that_breaks_off_is_said_so_far_and_the_others_whole(face, queue, error, caplog):
    def broken():
        yield tone(0.5)
        raise error

    stream = PlayoutStream("broken", RATE_HZ, face.playout.output_rate_hz)
    queue.add(spoken_chunks(broken(), stream, 1.0), "broken")
    add(queue, face, "whole", tone(0.3))
    face.play(lambda: face.playout.is_over)
    assert face.finished() == ["broken", "whole"]
    assert stream.n_received == len(tone(0.5))
    assert f"{error}; only the part before it is spoken" in caplog.text


def test_short_sentences_are_synthesised_a_few_ahead(face, queue):
    """Each is a request to the playout, which keeps 64 of everybody's."""
    spoken = text(face, "Hi. " * 200)
    queue.add(spoken, "text")
    settle(lambda: spoken.is_ahead)
    time.sleep(0.2)
    assert len(face.playout.requests) <= 6
    face.play(lambda: face.playout.is_over)
    assert face.finished() == ["text"] * 200


def test_when_it_is_closed_nothing_more_is_read_and_its_thread_ends(face):
    read = []

    def endless():
        while True:
            read.append(1)
            yield tone(1.0)

    queue = SpeechQueue(face.playout)
    for _ in range(3):
        stream = PlayoutStream("a", RATE_HZ, face.playout.output_rate_hz)
        queue.add(spoken_chunks(endless(), stream, 1.0), "a")
    settle(lambda: read)
    before = threading.active_count()
    queue.close()
    assert threading.active_count() == before - 1
    assert not face.playout.announced
    n_read = len(read)
    add(queue, face, "later", tone(1.0))
    assert len(read) == n_read


def test_the_text_of_a_voice_that_tells_no_times_is_told_with_its_sound(face, queue, tmp_path):
    soundfile.write(tmp_path / "said.wav", tone(0.2), RATE_HZ)
    own = Speaker("command", f"cp {tmp_path}/said.wav {{wav}}")
    spoken = spoken_text("Good morning.", face.playout, own)

    (stream,) = spoken.streams
    assert [word.label for word in stream.started_words[0].words] == ["Good", "morning"]
    queue.add(spoken, "text")
    face.play(lambda: face.finished() == ["text"])


def test_a_text_longer_than_an_agent_may_send_is_refused_whole_and_nothing_is_made(face):
    never = Speaker("command", "false")
    with pytest.raises(SynthesisError, match=r"of 30000 characters is too long.*at most 20000"):
        spoken_text("a" * 30_000, face.playout, never)


def test_words_of_a_file_are_told_where_it_is_taken_up(face, tmp_path):
    soundfile.write(tmp_path / "line.wav", tone(2.0), RATE_HZ)
    rows = [{"word": "good", "start": 0.1}, {"word": "morning", "start": 1.5}]
    (tmp_path / "line.json").write_text(json.dumps(rows))
    spoken = spoken_file(
        tmp_path / "line.wav", face.playout, start_s=1.0, phonemes=LabelFile(tmp_path / "line.json")
    )

    ((told,),) = [[word for each in s.started_words for word in each.words] for s in spoken.streams]
    assert (told.label, told.start_s) == ("morning", 0.5)


def test_a_file_goes_on_after_samples_that_are_no_numbers_and_they_count_as_lost(
    face, queue, tmp_path, caplog
):
    path = tmp_path / "long.wav"
    samples = np.full(70 * 4_000, 0.3, np.float32)
    samples[62 * 4_000 : 62 * 4_000 + 400] = np.nan
    soundfile.write(path, samples, 4_000, subtype="FLOAT")
    spoken = spoken_file(path, face.playout, start_s=60.0)
    queue.add(spoken, "long.wav")
    face.play(lambda: face.playout.is_over)

    assert not spoken.is_cut_short
    assert spoken.streams[-1].n_received == 10 * 4_000
    assert face.playout.lost_blocks == 10
    assert caplog.messages == [f"{path}: samples that are no numbers; played as silence"]


def test_a_voice_that_is_a_file_beside_the_yaml_is_found_there(tmp_path):
    (tmp_path / "joe.onnx").touch()
    sound = SoundSettings(synthesizer="piper", voice="joe.onnx")

    assert speaker_of(sound, tmp_path) == Speaker("piper", str(tmp_path / "joe.onnx"))
    assert speaker_of(SoundSettings(voice="x" * 900), tmp_path) == Speaker("espeak", "x" * 900)
    assert speaker_of(SoundSettings(), None) == Speaker("espeak", "")


def test_what_is_asked_for_one_text_changes_that_voice_and_no_more():
    own = Speaker("espeak", language="en-us")

    assert own.changed(None, None, None, None) == own
    assert own.changed("de", None, 120, 0) == Speaker("espeak", "", "de", 120, 0)
    assert Speaker("piper", "joe", "en-us").changed("", "", None, None) == Speaker(
        "piper", "", "en-us"
    )


def test_what_follows_a_sentence_heard_whole_is_dropped_by_an_interruption_in_between(face, queue):
    first, second = (PlayoutStream("text", RATE_HZ, RATE_HZ) for _ in range(2))
    for stream in (first, second):
        stream.push(tone(0.2))
        stream.end()
    synthesised = threading.Event()

    def pieces():
        assert synthesised.wait(PATIENCE_S)
        face.playout.requests.append(PlayoutRequest("say", second, after=first))
        yield second

    queue.add(SpeechItem(pieces(), deque([first]), 5.0, 0.2), "text")
    face.play(lambda: face.finished() == ["text"])
    face.ask("interrupt")
    face.play(lambda: not face.playout.requests)
    synthesised.set()
    face.play(lambda: face.playout.is_over)
    assert face.finished() == ["text"]
    assert second.is_dropped
