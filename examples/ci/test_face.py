"""A test of a voice agent: what it says opens the robot's mouth. `pytest`, where lipservo is."""

from importlib import resources

import soundfile

from lipservo.pytest_plugin import SimulatedFace


def test_what_my_agent_says_opens_the_mouth(simulated_face: SimulatedFace) -> None:
    """The jaw moves, and every servo says where it is."""
    clip = resources.files("lipservo.clips") / "welcome.flac"
    with resources.as_file(clip) as file:
        samples, rate_hz = soundfile.read(file, dtype="int16")
    simulated_face.play(samples[: 2 * rate_hz].tobytes(), rate_hz)

    assert len(simulated_face.encoders_deg()) == 10
    ticks = simulated_face.end()
    jaw_deg = [tick["sent_deg"][0] for tick in ticks]
    assert max(jaw_deg) - min(jaw_deg) > 2.0
