"""`lipservo.connect`: a program without an event loop speaks through a face."""

import threading

import numpy as np
import pytest
from lipservo_client.protocol import FaceError, Played
from voice_agents.served_face import DELAY_MS, RATE_HZ, ServedFace, tone, until

import lipservo
from lipservo.access.admission import Policy
from lipservo.agents.listener import AgentSettings


def energy(samples):
    return float(np.abs(samples).sum())


@pytest.mark.parametrize("kind", ["bytes", "int16", "float32", "column"])
def test_what_is_written_as_bytes_or_arrays_is_heard_and_counted(served, kind):
    pcm = np.frombuffer(tone(0.25), dtype="<i2")
    given = {
        "bytes": memoryview(tone(0.25)),
        "int16": pcm,
        "float32": pcm / np.float32(32_767),
        "column": pcm[:, None],
    }[kind]

    with lipservo.connect(served.url) as face, face.stream(sample_rate=RATE_HZ) as speech:
        assert speech.delay_ms == DELAY_MS
        assert speech.write(given)
        assert speech.wait() == Played(finished=True, played_s=0.25)
        assert speech.is_over
    assert energy(served.sound.played()) == pytest.approx(energy(pcm / 32_768), rel=1e-4)


@pytest.mark.parametrize("wrong", [np.zeros((10, 2)), np.zeros(10, dtype=np.int32), np.zeros(())])
def test_arrays_that_are_no_mono_sound_are_refused_and_the_stream_goes_on(served, wrong):
    with lipservo.connect(served.url) as face, face.stream() as speech:
        with pytest.raises(ValueError, match=r"samples have (shape|type)"):
            speech.write(wrong)
        speech.write(tone(0.1))
        assert speech.wait().finished


def test_more_than_a_message_holds_is_sent_in_pieces(served):
    with lipservo.connect(served.url) as face, face.stream() as speech:
        speech.write(tone(25.0))  # 1.2 MB
        assert speech.wait() == Played(finished=True, played_s=25.0)


def test_an_interruption_tells_what_was_heard(served):
    with lipservo.connect(served.url) as face:
        assert face.interrupt() is None
        events = face.events()
        with face.stream() as speech:
            speech.write(tone(20.0))
            while next(events)["type"] != "started":
                pass
            played = face.interrupt()

            assert not played.finished
            assert played.played_s + played.dropped_s == pytest.approx(20.0)
            assert speech.is_over
            assert not speech.write(tone(0.1))
            assert speech.wait() == played


def test_an_exception_on_the_way_is_silence(served):
    def speak(face):
        with face.stream() as speech:
            speech.write(tone(30.0))
            raise RuntimeError("the synthesiser failed")

    with lipservo.connect(served.url) as face:
        with pytest.raises(RuntimeError):
            speak(face)
        until(lambda: served.playout.is_over)
        assert len(served.sound.played()) < 29 * RATE_HZ


def test_marks_come_among_the_events_in_order(served):
    with lipservo.connect(served.url) as face:
        events = face.events()
        with face.stream(stream="joke") as speech:
            speech.write(tone(0.2))
            speech.mark("half")
            speech.write(tone(0.2))
            speech.wait()
        told = []
        while not told or told[-1]["type"] != "finished":
            told.append(next(events))

    (mark,) = [event for event in told if event["type"] == "mark"]
    assert (mark["name"], mark["stream"]) == ("half", "joke")
    assert mark["played_s"] == pytest.approx(0.2, abs=0.03)


def test_events_end_with_the_connection_in_another_thread_too(served):
    told = []
    with lipservo.connect(served.url) as face:
        events = face.events()
        reading = threading.Thread(target=lambda: told.extend(events))
        reading.start()
        with face.stream() as speech:
            speech.write(tone(0.1))
            speech.wait()
        until(lambda: "finished" in [event["type"] for event in told])
    reading.join(60.0)

    assert not reading.is_alive()


def test_commands_reach_the_face(served):
    with lipservo.connect(served.url) as face:
        assert face.status()["state"] == "driven"
        face.set("strength", 0.8)
        assert served.commands.take_changes() == {"strength": 0.8}
        with pytest.raises(FaceError, match="0 to 2"):
            face.set("strength", 8.0)
        with pytest.raises(FaceError) as no_voice:
            face.say("hello")
        with pytest.raises(FaceError):
            face.play("clip.wav")
        face.stop("freeze")
        until(lambda: served.stops)

    assert no_voice.value.code == "not_available"
    assert served.stops == ["freeze"]


def test_a_second_speaker_is_told_in_one_line(served):
    with lipservo.connect(served.url) as first, lipservo.connect(served.url) as second:
        with first.stream() as speech:
            speech.write(tone(0.1))
            with pytest.raises(FaceError, match="another client is speaking") as busy:
                second.stream().__enter__()
        assert busy.value.code == "busy"


def test_where_nobody_answers_it_is_one_line():
    with pytest.raises(FaceError, match="no face answers there") as error:
        lipservo.connect("ws://127.0.0.1:9").__enter__()
    assert error.value.code == "not_answering"


@pytest.mark.parametrize("url", ["http://127.0.0.1:8765", "nonsense"])
def test_what_is_no_address_is_one_line(url):
    with pytest.raises(FaceError, match="is not the address of a face"):
        lipservo.connect(url).__enter__()


def test_the_token_is_needed():
    with ServedFace(AgentSettings(policy=Policy("sesame"))) as served:
        with pytest.raises(FaceError, match="needs the token"):
            lipservo.connect(served.url).__enter__()
        with lipservo.connect(served.url, token="sesame") as face:
            assert face.status()["state"] == "driven"


def test_a_face_that_ends_is_told_to_who_waits(served):
    """By the end of its speech, if the face's last words arrive, or by an error."""
    with lipservo.connect(served.url) as face, face.stream() as speech:
        speech.write(tone(20.0))
        ending = threading.Thread(target=served.server.__exit__)
        ending.start()
        try:
            end = speech.wait()
        except FaceError as error:
            end = error
        ending.join(60.0)

    assert getattr(end, "code", "") in ("shutting_down", "disconnected") or end.dropped_s > 0.0


def test_a_proxy_for_the_web_is_not_asked_for_a_face(served, monkeypatch):
    """It would get the token, and there is none here: who asked it would find no face."""
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:1")
    with lipservo.connect(served.url) as face:
        assert face.status()["state"] == "driven"
