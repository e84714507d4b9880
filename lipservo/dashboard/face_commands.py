"""What a page or a program may ask of a face: by its control socket, and by its agent server.

Stops have threads of their own, so that none waits behind anything that hangs. Everything raises
FaceError, one line, with a code of docs/agents.md: refused, not_answering, not_available.
"""

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import urlsplit

from firmware_bridge.orders import ServoSwitch
from firmware_bridge.process.control_client import (
    arm_jog,
    ask,
    change_settings,
    end_jog,
    jog_servo,
    stop_and_wait,
    switch_servo,
)
from firmware_bridge.process.runtime_folder import ControlError
from firmware_bridge.stopping import StopLevel
from lipservo.client.async_face import AsyncFace
from lipservo.client.face_answers import FaceError
from lipservo.speech.passing_wish import whole_wish
from lipsync.errors import UserError, shown

Answer = Mapping[str, Any]
#: Agents answer `say` and `play` once they have the words or the file, not once these are said.
_SAYING_S: Final = 12.0
#: Stops that wait for the report of the end.
_MOST_WAITING: Final = 8


class FaceCommands:
    """Commands to one face."""

    def __init__(self, find: Callable[[], Path], token: str | None = None) -> None:
        """find: where the face listens, called in a thread; raises UserError, ControlError.

        token: what the face's agent server asks for.
        """
        self._find = find
        self._token = token
        self._path: Path | None = None
        self.status: dict[str, Any] | None = None
        self._stops = ThreadPoolExecutor(8, thread_name_prefix="dashboard stop")
        self._ends = ThreadPoolExecutor(_MOST_WAITING, thread_name_prefix="dashboard end")
        self._n_waiting = 0
        self._others = ThreadPoolExecutor(2, thread_name_prefix="dashboard command")

    async def stop(self, level: str = StopLevel.SOFT, wait_s: float = 0.0) -> Answer:
        """Stop the face: soft, freeze or limp; the answer says that it is taken.

        wait_s: so long for the end; `report` is then what the servos confirmed (`StopReport`), or
        None where no end came, or too many wait for one: a stop itself never waits for a thread.
        """
        if level not in set(StopLevel):
            raise FaceError("refused", f"{shown(level)}: no stop; there are soft, freeze, limp")
        if not wait_s or self._n_waiting >= _MOST_WAITING:
            return await self._told(partial(_asked, level), self._stops)
        waiting = partial(self._reached_at, partial(_stopped, StopLevel(level), wait_s))
        asked = asyncio.get_running_loop().run_in_executor(self._ends, waiting)
        self._n_waiting += 1
        asked.add_done_callback(self._end_waiting)  # also where nobody waits for it any more
        return await asyncio.shield(asked)

    def _end_waiting(self, asked: "asyncio.Future[Answer]") -> None:
        self._n_waiting -= 1
        if not asked.cancelled():
            asked.exception()  # nobody need be there to hear it

    async def interrupt(self) -> None:
        """Silence now: what the face says or plays is dropped."""
        try:
            async with asyncio.timeout(_SAYING_S), AsyncFace(self._speech_url(), self._token) as f:
                await f.interrupt()
        except TimeoutError as error:
            raise FaceError("not_answering", "the face's speech side does not answer") from error

    async def change(self, values: Mapping[str, float]) -> Answer:
        """Other values of settings: all of them, or none."""
        if not values:
            raise FaceError("refused", "name at least one setting")
        for name, value in values.items():
            if not math.isfinite(value):
                raise FaceError("refused", f"{shown(name)}: {value} is no number to set")
        return await self._told(partial(_changed, dict(values)))

    async def servo(self, name: str, what: str) -> Answer:
        """One servo: off, on or reboot."""
        if what not in set(ServoSwitch):
            raise FaceError("refused", f"{shown(what)}: there are off, on, reboot")
        return await self._told(partial(_switched, name, ServoSwitch(what)))

    async def jog_arm(self) -> Answer:
        """Single servos may be moved by hand from now on; to be renewed within 3 s."""
        return await self._told(arm_jog)

    async def jog(self, name: str, deg: float) -> Answer:
        """One servo to an angle of its joint, within its limits; renews."""
        if not math.isfinite(deg):
            raise FaceError("refused", f"{shown(name)}: {deg} is no angle")
        return await self._told(partial(_jogged, name, deg))

    async def jog_end(self) -> Answer:
        """The face goes on as before."""
        return await self._told(end_jog)

    async def look_at(self, yaw_deg: float | None, pitch_deg: float | None = None) -> Answer:
        """Look there, yaw to its own left and pitch upwards; None: at nothing in particular."""
        if yaw_deg is None:
            return await self.change({"look_weight": 0.0})
        angles = {"look_yaw_deg": yaw_deg, "look_pitch_deg": pitch_deg or 0.0}
        return await self.change(whole_wish(angles, time.monotonic()))

    async def affect(self, valence: float, arousal: float, tau_s: float) -> Answer:
        """A mood, -1 to 1 each, which fades with the time constant `tau_s`."""
        mood = {"affect_valence": valence, "affect_arousal": arousal, "affect_tau_s": tau_s}
        return await self.change(whole_wish(mood, time.monotonic()))

    async def say(self, text: str) -> Answer:
        """A text, in the face's own voice."""
        return await self._speak("say", text)

    async def play(self, file: str) -> Answer:
        """A sound file of the folder that the face plays from."""
        return await self._speak("play", file)

    def close(self) -> None:
        """Nothing more is asked; who waits is told."""
        for pool in (self._stops, self._ends, self._others):
            pool.shutdown(wait=False, cancel_futures=True)

    async def _speak(self, kind: Literal["say", "play"], what: str) -> Answer:
        try:
            url = self._speech_url()
            async with asyncio.timeout(_SAYING_S), AsyncFace(url, self._token) as face:
                return await (face.say(what) if kind == "say" else face.play(what))
        except TimeoutError as error:
            raise FaceError("not_answering", "the face's speech side does not answer") from error

    def _speech_url(self) -> str:
        url = (self.status or {}).get("listens_on")
        if url is None:
            hint = "it speaks when it was started by `lipservo daemon`, with --play"
            raise FaceError("not_available", f"the face takes no speech: {hint}")
        return _reached(url)

    async def _told(
        self, tell: Callable[[Path], Answer], pool: ThreadPoolExecutor | None = None
    ) -> Answer:
        """What the face answers. tell: asks it at a path."""
        loop = asyncio.get_running_loop()
        asked = partial(self._reached_at, tell)
        answer = await loop.run_in_executor(pool or self._others, asked)
        if "error" in answer:
            raise FaceError("refused", str(answer["error"]))
        return answer

    def _reached_at(self, tell: Callable[[Path], Answer]) -> Answer:
        """In a thread: where the face was last, or wherever it is by now."""
        path = self._path
        try:
            if path is None:
                return tell(self._find())
            try:
                return tell(path)
            except (FileNotFoundError, ConnectionError):
                return tell(self._find())
        except TimeoutError as error:
            hint = "`lipservo stop --limp` lets its servos go"
            raise FaceError("not_answering", f"the face hangs; {hint}") from error
        except PermissionError as error:
            raise FaceError("not_answering", "the face may not be asked by this user") from error
        except (OSError, UserError, ControlError) as error:
            raise FaceError("not_answering", f"no face answers: {error}") from error


def _asked(word: str, path: Path) -> Answer:
    return ask(path, word)


def _changed(values: Mapping[str, float], path: Path) -> Answer:
    return change_settings(path, values)


def _switched(name: str, switch: ServoSwitch, path: Path) -> Answer:
    return switch_servo(path, name, switch)


def _jogged(name: str, position_deg: float, path: Path) -> Answer:
    return jog_servo(path, name, position_deg)


def _stopped(level: StopLevel, wait_s: float, path: Path) -> Answer:
    answer, report = stop_and_wait(path, level, wait_s)
    return {**answer, "report": report}


def _reached(url: str) -> str:
    """A server that listens at every address of this computer is asked at loopback."""
    split = urlsplit(url)
    if split.hostname in ("0.0.0.0", "::"):
        host = "127.0.0.1" if split.hostname == "0.0.0.0" else "[::1]"
        return f"{split.scheme}://{host}:{split.port}"
    return url
