"""All that our clients can send, and what comes back, against the schema of the protocol."""

import pytest
from lipservo_client.protocol import FaceError
from voice_agents.served_face import RATE_HZ, ServedFace, tone

import lipservo

pytestmark = pytest.mark.usefixtures("traffic_by_the_schema")
UNITS = [("words", [("good", 0, 600), "day"]), ("phonemes", [("G", 0), ("UH", 900)])]


async def test_the_traffic_of_the_client_for_asyncio(served):
    async with lipservo.connect_async(served.url) as face:
        async with face.stream(RATE_HZ) as speech:
            await speech.tell("Good day.")
            for units in UNITS:
                await speech.tell(units)
            await speech.tell(("visemes", [("20", 0)]), alphabet="azure")
            await speech.write(tone(0.3))
            await speech.mark("half")
            await face.pause()
            await face.resume()
            await face.wire.send("position")
        await speech.wait()
        async with face.stream(RATE_HZ, "client") as speech:
            await speech.write(tone(0.1))
            await speech.report_played(0.05)
            await face.interrupt()
        await face.set("strength", 0.5)
        await face.status()
        with pytest.raises(FaceError) as refused:
            await face.set("height", 1.0)
        assert refused.value.code == "refused"


def test_the_traffic_of_the_client_that_waits():
    with ServedFace(has_voice=True) as face, lipservo.connect(face.url) as connection:
        with connection.stream(sample_rate=RATE_HZ) as speech:
            speech.tell("Good day.")
            speech.write(tone(0.2))
            speech.mark("end")
            assert speech.wait().finished
        connection.say("Good day.")
        connection.interrupt()
