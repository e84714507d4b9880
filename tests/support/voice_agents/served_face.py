"""A face that voice agents can connect to: real server, playout and control socket, no robot.

Only the sound device and the clock are made up: the loop says 20 ms of sound a millisecond, or
more.
"""

import asyncio
import contextlib
import json
import threading
import time

import numpy as np
from places import short_folder
from websockets.asyncio.client import connect

from firmware_bridge.process.commands import CommandQueue, Setting
from firmware_bridge.process.control_socket import ControlSocket
from lipservo.agents.agent_server import AgentServer
from lipservo.agents.listener import AgentSettings, bind_listener
from lipservo.agents.protocol_schema import EVENTS
from lipservo.runtime.sound import SpeechQueue, spoken_chunks
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutStream

#: Far more than anything here takes.
PATIENCE_S = 60.0
RATE_HZ = 24_000
DELAY_MS = 230.0
LEAD_S = 0.2


class KeptSound:
    """A loudspeaker that keeps what it was given, and plays up to where the loop says."""

    rate_hz = RATE_HZ
    latency_s = 0.0
    n_underruns = 0

    def __init__(self):
        self.samples = np.zeros(0, dtype=np.float32)
        self.position_s = 0.0
        self._chunks = []

    def write(self, samples):
        self._chunks.append(samples.copy())

    def silence_rest(self):
        self._join()
        self.samples[round(self.position_s * RATE_HZ) :] = 0.0
        return self.position_s

    def position(self):
        return None

    def played(self):
        """What has left it."""
        self._join()
        return self.samples[: round(self.position_s * RATE_HZ)]

    def _join(self):
        n_chunks = len(self._chunks)
        self.samples = np.concatenate((self.samples, *self._chunks[:n_chunks]))
        del self._chunks[:n_chunks]


class ForgottenSound(KeptSound):
    """The same for hours of sound."""

    def write(self, samples):
        """Keep nothing."""


class ServedFace:
    """See the module; a context manager. sound: kind of its loudspeaker; None: it has none.

    A text is said, where there is a voice, as a tone of 0.1 s a character. step_s: so much is heard
    a millisecond.
    """

    def __init__(
        self, settings=None, sound=KeptSound, *, has_voice=False, port=0, step_s=0.02, **given
    ):
        self.settings = settings or AgentSettings(position_s=0.02)
        self.sound = sound() if sound is not None else None
        self.playout = Playout(self.sound)
        self.reported = []
        self.texts, self.asked = [], []
        self._queue = SpeechQueue(self.playout)
        if has_voice:
            given["say"] = self._say
        self.commands = CommandQueue({"strength": Setting(1.0, 0.0, 2.0)})
        self.stops = []
        self._held = threading.Event()
        self._step_s = step_s
        self._stands = threading.Event()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        listener = bind_listener(f"127.0.0.1:{port}", self.settings.policy.token)
        self.path = short_folder() / "face.sock"
        self.server = AgentServer(
            listener,
            self.playout,
            control_path=self.path,
            delay_ms=lambda: DELAY_MS,
            settings=self.settings,
            **given,
        )
        self.url = self.server.status()["url"]

    def __enter__(self):
        self._control = ControlSocket(self.path, commands=self.commands)
        self._thread.start()
        self.server.__enter__()
        return self

    def __exit__(self, *exc):
        self.server.__exit__(*exc)
        self._over.set()
        self._thread.join(PATIENCE_S)
        self._queue.close()
        self._control.__exit__(*exc)

    def hold(self):
        """Sound stands still: what was asked is still done."""
        self._stands.clear()
        self._held.set()
        assert self._stands.wait(PATIENCE_S)

    def go_on(self):
        self._held.clear()

    def _say(self, given, name):
        text = given.text
        self.texts.append(text)
        self.asked.append(given.model_dump(exclude_none=True))
        samples = np.frombuffer(tone(0.1 * len(text)), "<i2").astype(np.float32) / 32_768
        stream = PlayoutStream(name, RATE_HZ, self.playout.output_rate_hz)
        spoken = spoken_chunks(iter([samples]), stream, 0.1 * len(text))
        self._queue.add(spoken, "text")
        return spoken

    def _run(self):
        position_s = 0.0
        while not self._over.is_set():
            if self.sound is not None:
                self.sound.position_s = position_s
            while self.playout.reports:
                self.reported.append(self.playout.reports.popleft())
            self.playout.advance(position_s)
            self.playout.blocks(position_s + LEAD_S)
            stop = self._control.poll()
            speaking = self.playout.speaking
            about = {"state": "driven", "servos": {"jaw": "driven"}, "speaking": speaking}
            self._control.answer(lambda about=about: about)
            if stop is not None:
                self.stops.append(stop.level)
            if self._held.is_set():
                self._stands.set()
            else:
                position_s += self._step_s
            time.sleep(0.001)


def tone(duration_s, rate_hz=RATE_HZ):
    """A tone, as bytes of s16le; hardly a sample of it is zero."""
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    return (8_000 * np.sin(2 * np.pi * 211 * time_s)).astype("<i2").tobytes()


def distinct(duration_s, seed=0):
    """Samples (int16) without a zero: what is lost or doubled of them is seen."""
    rng = np.random.default_rng(seed)
    return rng.integers(1, 30_000, round(duration_s * RATE_HZ)).astype("<i2")


def heard(face):
    """What left a face's loudspeaker, as int16, without the silence between."""
    samples = np.rint(face.sound.played() * 32_768).astype(int)
    return samples[samples != 0]


def sounding_s(face):
    """How many seconds of it were no silence."""
    return np.count_nonzero(face.sound.played()) / RATE_HZ


def until(condition):
    """Wait for what other threads do."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        time.sleep(0.002)


class RawClient:
    """The bare wire: JSON texts and bytes. What comes is held against the protocol's schema."""

    def __init__(self, socket, path="/stream"):
        self.socket = socket
        self._schema = EVENTS[path]
        self.heard = []

    async def say(self, kind, **fields):
        await self.socket.send(json.dumps({"type": kind, **fields}))

    async def start(self, stream="s", **fields):
        """Start a stream; the answer."""
        await self.say("start", stream=stream, **{"sample_rate": RATE_HZ, **fields})
        return await self.next("ready", "error")

    async def begin(self, duration_s, stream="s"):
        """Start a stream with so much sound, and wait until it is heard."""
        await self.start(stream)
        await self.send(tone(duration_s))
        await self.next("started")

    async def finish(self, duration_s):
        """Send so much sound and the end of its stream; what is told when it was heard."""
        await self.send(tone(duration_s))
        await self.say("end")
        return await self.next("finished")

    async def send(self, data):
        await self.socket.send(data)

    async def next(self, *kinds):
        """The next event of these kinds."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                event = json.loads(await self.socket.recv())
                self._schema.validate_python(event)
                self.heard.append(event)
                if event["type"] in kinds:
                    return event


@contextlib.asynccontextmanager
async def client(face, path="/stream", **arguments):
    async with connect(face.url + path, **arguments) as socket:
        yield RawClient(socket, path)
