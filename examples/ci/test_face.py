"""Tests of a voice agent with a simulated face. `pytest`, where lipservo is."""

from lipservo.pytest_plugin import SimulatedFace


def test_what_my_agent_says_opens_the_mouth(simulated_face: SimulatedFace) -> None:
    """The jaw moves, and every servo says where it is."""
    simulated_face.play(*simulated_face.clip(2.0))

    assert len(simulated_face.encoders_deg()) == 10
    ticks = simulated_face.end()
    jaw_deg = [tick["sent_deg"][0] for tick in ticks]
    assert max(jaw_deg) - min(jaw_deg) > 2.0


def test_my_agent_learns_how_much_was_heard(shared_simulated_face: SimulatedFace) -> None:
    """The agent of the README: the face plays its sound, here without a loudspeaker."""
    samples, rate_hz = shared_simulated_face.clip(1.0)
    with shared_simulated_face.connect() as face:
        with face.stream(rate_hz) as speech:
            speech.tell("Hello")
            speech.write(samples)
            speech.mark("greeting")
            played = speech.wait()
        face.interrupt()
    assert played.finished
    assert abs(played.played_s - 1.0) < 0.01
