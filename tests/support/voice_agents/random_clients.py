"""Clients that send anything at all, and what must be true of the face afterwards."""

import asyncio
import base64
import gc
import itertools
import json
import tracemalloc

from logged import logged
from voice_agents.served_face import (
    PATIENCE_S,
    RATE_HZ,
    ForgottenSound,
    ServedFace,
    client,
    tone,
    until,
)
from websockets.exceptions import ConnectionClosed, InvalidStatus

from lipservo.agents.listener import AgentSettings

_TYPES = ["hello", "start", "audio", "end", "interrupt", "clear", "mark", "position", "dance"]
_TYPES += ["pause", "resume", "text", "words", "phonemes", "phonemes", "visemes"]
_COMMANDS = ["status", "set", "say", "play", "dance"]
_TEXTS = ["", "x", "🙂", "\ud800", "a" * 300, "<speak/>", "../../etc/passwd"]


def _any(rng):
    """A value of any kind."""
    numbers = [0, -1, 1.5, 1e308, 10**30, 24_000, float("nan")]
    return rng.choice([None, True, [], {}, [[[]]], *_TEXTS, *numbers])


def _units(rng, labels):
    """In order mostly, at times backwards, far off or without times."""
    at, units = rng.choice([0, 0, 1_000, 10**9]), []
    for _ in range(rng.randrange(1, 6)):
        unit = {"label": rng.choice(labels)}
        if rng.random() < 0.9:
            unit["start_sample"] = at
        if rng.random() < 0.5:
            unit["end_sample"] = at + rng.choice([0, 24, 2_400, -1])
        at += rng.choice([2_400, 2_400, 24, 0, -500])
        units.append(unit)
    return units


def _fields(rng, kind):
    right = {
        "text": {"text": rng.choice(_TEXTS)},
        "words": {"units": _units(rng, [*_TEXTS, "hello"])},
        "phonemes": {
            "units": _units(rng, ["M", "AA", "SIL", "a", "Q", ""]),
            "alphabet": rng.choice(["arpabet", "ipa", "klingon"]),
        },
        "visemes": {"units": _units(rng, ["0", "21", "99"]), "alphabet": "azure"},
        "start": {
            "stream": rng.choice(["a", "b"]),
            "sample_rate": rng.choice([8_000, 16_000, 24_000, 44_100, 48_000]),
            "format": rng.choice(["s16le", "f32le"]),
            "playback": rng.choice(["server", "client"]),
        },
        "audio": {"data": base64.b64encode(rng.randbytes(rng.randrange(200))).decode()},
        "mark": {"name": rng.choice(["m", "n"])},
        "position": {"played_s": rng.random()},
        "set": {"name": "strength", "value": rng.random() * 3},
        "say": {"text": rng.choice(_TEXTS)},
        "play": {"file": rng.choice(_TEXTS)},
    }.get(kind, {})
    if rng.random() < 0.15:
        right = {**right, rng.choice(["stream", "sample_rate", "data", "name", "id"]): _any(rng)}
    return right


def random_message(rng, kinds):
    """Text or bytes: mostly right, at times wrong, at times noise."""
    draw = rng.random()
    if draw < 0.35:
        return rng.randbytes(rng.choice([0, 1, 2, 3, 480, 961, 4_800]))
    if draw < 0.38:
        return rng.choice(["", "{", "null", '"start"', "[" * 3_000, '{"type": 1}', "\0"])
    kind = rng.choice(kinds)
    return json.dumps({"type": kind, **_fields(rng, kind)})


async def _storm(face, rng, n_messages):
    """One connection after the other; some end well, some in the middle of a word."""
    sent = 0
    while sent < n_messages:
        path, kinds = rng.choice([("/stream", _TYPES)] * 3 + [("/control", _COMMANDS)])
        try:
            async with client(face, path, ping_interval=None) as agent:
                reading = asyncio.ensure_future(_read(agent.socket))
                for _ in range(min(n_messages - sent, rng.randrange(1, 400))):
                    await agent.send(random_message(rng, kinds))
                    sent += 1
                if rng.random() < 0.5:
                    agent.socket.transport.abort()
                await agent.socket.close()
                await reading
        except (ConnectionClosed, InvalidStatus):
            continue


async def _read(socket):
    try:
        async for _ in socket:
            pass
    except ConnectionClosed:
        pass


async def _say_something(face):
    async with client(face) as agent:
        while (await agent.start("sane"))["type"] != "ready":
            await asyncio.sleep(0.01)
        await agent.send(tone(0.1))
        await agent.say("end")
        return await agent.next("finished")


def survive(rng, n_messages, n_at_once=4):
    """Send so many messages in four storms: the least growth of memory of the last three, in bytes.

    What leaks grows in every storm; a queue that happens to be full at the end of one does not.

    Raises AssertionError where the face is not as before: it speaks when asked, and then is silent.
    """
    settings = AgentSettings(messages_per_s=1e9, when_busy=rng.choice(["refuse", "queue"]))
    with (
        logged("lipservo.agents") as lines,
        ServedFace(settings, sound=ForgottenSound, has_voice=True) as face,
    ):

        async def storm(n):
            each = n // n_at_once
            await asyncio.gather(*(_storm(face, rng, each) for _ in range(n_at_once)))

        def calm():
            # Streams that were ended are said to their end.
            until(lambda: face.playout.is_over and not face.server.status()["n_clients"])

        tracemalloc.start()
        try:
            used = []
            for _ in range(4):
                asyncio.run(storm(n_messages // 4))
                calm()
                gc.collect()
                used.append(tracemalloc.get_traced_memory()[0])
        finally:
            tracemalloc.stop()
        finished = asyncio.run(asyncio.wait_for(_say_something(face), PATIENCE_S))
        assert finished["n_played"] == round(0.1 * RATE_HZ)
        failed = [line for line in lines if "failed" in line or "ended" in line]
        assert failed == []
    return min(after - before for before, after in itertools.pairwise(used))
