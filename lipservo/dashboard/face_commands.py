"""Commands of pages and programs to a face: by its control socket, and by its agent server.

A stop is sent elsewhere, in the event loop (`web/stop_route.py`); here is kept where to. Everything
raises FaceError, one line, with a code of docs/agents.md: refused, not_answering, not_available.
"""

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import urlsplit

from lipservo_client.async_face import AsyncFace
from lipservo_client.face_answers import FaceError

from firmware_bridge.orders import ServoSwitch
from firmware_bridge.process.control_client import (
    arm_jog,
    ask,
    change_settings,
    end_jog,
    jog_servo,
    start_face,
    switch_servo,
)
from firmware_bridge.process.runtime_folder import ControlError
from lipservo.speech.passing_wish import whole_wish
from lipsync.errors import UserError, shown

Answer = Mapping[str, Any]
#: Agents answer `say` and `play` once they have the words or the file, not once these are said.
_SAYING_S: Final = 12.0
#: Stops that wait for the report of the end; the control socket has room for 16 clients.
_MOST_WAITING: Final = 8
#: Between two statuses while a face is started.
_LOOK_EVERY_S: Final = 0.1
_STATUS_S: Final = 1.0
#: States of a face that is being brought up; any other is the end of it.
_ON_ITS_WAY: Final = ("the bridge starts", "driven")


class FaceCommands:
    """Commands to one face."""

    def __init__(
        self,
        find: Callable[[], Path],
        token: str | None = None,
        control_path: Path | None = None,
    ) -> None:
        """find: where the face listens, called in a thread; raises UserError, ControlError.

        token: what the face's agent server requires; None: it is found, where the face runs on this
        computer. control_path: where the face listens, as far as it is known.
        """
        self._find = find
        self._token = token
        #: Where the face listens, or listened last: a stop is sent there without a look-up.
        self.control_path = control_path
        self.status: dict[str, Any] | None = None
        self._n_waiting = 0
        self._locating: asyncio.Task[Path] | None = None
        self._finding = ThreadPoolExecutor(1, thread_name_prefix="dashboard find")
        self._starting = ThreadPoolExecutor(2, thread_name_prefix="dashboard start")
        self._others = ThreadPoolExecutor(2, thread_name_prefix="dashboard command")

    async def located(self) -> Path:
        """Find the face anew, where none listens at `control_path`; it is kept there."""
        if self._locating is None or self._locating.done():
            self._locating = asyncio.create_task(self._located())
        return await asyncio.shield(self._locating)

    async def _located(self) -> Path:
        loop = asyncio.get_running_loop()
        try:
            self.control_path = await loop.run_in_executor(self._finding, self._find)
        except PermissionError as error:
            raise FaceError("not_answering", "this user may not command the face") from error
        except (OSError, UserError, ControlError) as error:
            why = " ".join(str(error).split())
            raise FaceError("not_answering", f"no face answers: {why}") from error
        return self.control_path

    @contextlib.contextmanager
    def waiting_for_end(self, wait_s: float) -> Iterator[float]:
        """How long a stop waits for the report of the end; 0: so many wait for one already."""
        if not wait_s or self._n_waiting >= _MOST_WAITING:
            yield 0.0
            return
        self._n_waiting += 1
        try:
            yield wait_s
        finally:
            self._n_waiting -= 1

    async def start(self, wait_s: float = 0.0) -> Answer:
        """Start a stopped face; it moves.

        Parameters
        ----------
        wait_s : so long until it is driven; 0: the answer says that the start is accepted.

        Returns
        -------
        {"accepted": "start"}; with `wait_s` also `state`, `servos` and `troubles` of its status
        when every servo is driven, when it has come to another state, or when the time is over.

        """
        answer = dict(await self._returned(start_face, self._starting))
        if not wait_s:
            return {"accepted": answer.get("accepted")}
        loop = asyncio.get_running_loop()
        give_up_s = loop.time() + wait_s
        status: Answer = {}
        while loop.time() < give_up_s:
            await asyncio.sleep(_LOOK_EVERY_S)
            with contextlib.suppress(FaceError):
                status = await self._returned(_described, self._starting)
                states = set(dict(status.get("servos") or {}).values())
                if status.get("state") not in _ON_ITS_WAY or states == {"driven"}:
                    break
        known = {name: status.get(name) for name in ("state", "servos", "troubles")}
        return {"accepted": answer.get("accepted"), **known}

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
        return await self._returned(partial(_changed, dict(values)))

    async def servo(self, name: str, what: str) -> Answer:
        """One servo: off, on or reboot."""
        if what not in set(ServoSwitch):
            raise FaceError("refused", f"{shown(what)}: there are off, on, reboot")
        return await self._returned(partial(_switched, name, ServoSwitch(what)))

    async def jog_arm(self) -> Answer:
        """Single servos may be moved by hand from now on; to be renewed within 3 s."""
        return await self._returned(arm_jog)

    async def jog(self, name: str, deg: float) -> Answer:
        """One servo to an angle of its joint, within its limits; renews."""
        if not math.isfinite(deg):
            raise FaceError("refused", f"{shown(name)}: {deg} is no angle")
        return await self._returned(partial(_jogged, name, deg))

    async def jog_end(self) -> Answer:
        """The face goes on as before."""
        return await self._returned(end_jog)

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
        """Nothing more is sent; what waits fails."""
        for pool in (self._finding, self._starting, self._others):
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

    async def _returned(
        self, call: Callable[[Path], Answer], pool: ThreadPoolExecutor | None = None
    ) -> Answer:
        """The face's answer. call: speaks to it, at a path, in a thread."""
        loop = asyncio.get_running_loop()
        answer = await loop.run_in_executor(pool or self._others, partial(self._called, call))
        if "error" in answer:
            raise FaceError("refused", str(answer["error"]))
        return answer

    def _called(self, call: Callable[[Path], Answer]) -> Answer:
        """In a thread: where the face was last, or wherever it is by now."""
        path = self.control_path
        try:
            if path is None:
                return call(self._find())
            try:
                return call(path)
            except (FileNotFoundError, ConnectionError):
                return call(self._find())
        except TimeoutError as error:
            hint = "`lipservo stop --limp` lets its servos go"
            raise FaceError("not_answering", f"the face hangs; {hint}") from error
        except PermissionError as error:
            raise FaceError("not_answering", "this user may not command the face") from error
        except (OSError, UserError, ControlError) as error:
            raise FaceError("not_answering", f"no face answers: {error}") from error


def _described(path: Path) -> Answer:
    return ask(path, "status", _STATUS_S)


def _changed(values: Mapping[str, float], path: Path) -> Answer:
    return change_settings(path, values)


def _switched(name: str, switch: ServoSwitch, path: Path) -> Answer:
    return switch_servo(path, name, switch)


def _jogged(name: str, position_deg: float, path: Path) -> Answer:
    return jog_servo(path, name, position_deg)


def _reached(url: str) -> str:
    """A server that listens at every address of this computer is asked at loopback."""
    split = urlsplit(url)
    if split.hostname in ("0.0.0.0", "::"):
        host = "127.0.0.1" if split.hostname == "0.0.0.0" else "[::1]"
        return f"{split.scheme}://{host}:{split.port}"
    return url
