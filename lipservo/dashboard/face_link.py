"""The dashboard's hold on a running face: its state, thirty times a second, and commands.

The dashboard is a client of a face like any other. What it reads is memory that the face writes
anyway, and a status that it asks for twice a second; if all of it hangs, no face does. Commands go
by the face's control socket and by its agent server. A stop is sent elsewhere, in the event loop
(`web/stop_route.py`); here is kept where to. Commands raise FaceError, one line, with a code of
docs/agents.md: refused, not_answering, not_available.
"""

import asyncio
import contextlib
import math
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from lipservo_client.async_face import AsyncFace
from lipservo_client.protocol import FaceError

from firmware_bridge.process.control_client import (
    arm_jog,
    ask,
    change_settings,
    end_jog,
    jog_pulse,
    jog_servo,
    start_face,
    switch_servo,
    watch,
)
from firmware_bridge.process.runtime_folder import ControlError
from firmware_bridge.stopping import ServoSwitch
from lipservo.dashboard.live_frames import NO_LAYOUT, RATE_HZ, BoardReader, Moment, encode
from lipservo.runtime.servos.assembly import load_settings
from lipservo.runtime.speech.passing_wish import with_expiry
from lipservo.runtime.status.live_board import BoardLayout, LiveBoard
from lipsync.errors import UserError, shown

Answer = Mapping[str, Any]
#: Agents answer `say` and `play` once they have the words or the file, not once these are said.
_SAYING_S: Final = 12.0
#: Stops that wait for the report of the end; the control socket has room for 16 clients.
_MOST_WAITING: Final = 8
#: Between two statuses while a face is started.
_LOOK_EVERY_S: Final = 0.1
#: States of a face that is being brought up; any other is the end of it.
_ON_ITS_WAY: Final = ("the bridge starts", "driven")
STATUS_EVERY_S: Final = 0.5
#: A status older than this is no longer shown as one.
STATUS_OLD_S: Final = 1.0
_STATUS_PATIENCE_S: Final = 1.0
#: A board that nobody writes is asked for anew so often: another face may listen there by now.
_WATCH_EVERY_S: Final = 2.0
#: For pages that join late.
HISTORY_S: Final = 30


class FaceLink:
    """One face, seen and commanded. Its tasks run within `async with link.running()`.

    control_path: where the face listens, or listened last: a stop is sent there without a look-up.
    layout: names of servos, states, phonemes, of the face that was seen last. moment: the newest.
    status: the face's newest answer, None before the first. trouble: why there is none just now.
    history: encoded frames of the last seconds. on_moment: called at every tick. origins: of web
    pages that the face's YAML lists.
    """

    def __init__(
        self,
        find: Callable[[], Path],
        token: str | None = None,
        control_path: Path | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """find: where the face listens, called in a thread; raises UserError, ControlError.

        token: what the face's agent server requires; None: it is found, where the face runs on this
        computer. control_path: where the face listens, as far as it is known.
        """
        self._find = find
        self._token = token
        self._clock = clock
        self.control_path = control_path
        self.status: dict[str, Any] | None = None
        self._n_waiting = 0
        self._locating: asyncio.Task[Path] | None = None
        self._finding = ThreadPoolExecutor(1, thread_name_prefix="dashboard find")
        self._starting = ThreadPoolExecutor(2, thread_name_prefix="dashboard start")
        self._others = ThreadPoolExecutor(2, thread_name_prefix="dashboard command")
        self._asking = ThreadPoolExecutor(1, thread_name_prefix="dashboard status")
        self._started_s = clock()
        self._status_s = float("-inf")
        self._watched_s = float("-inf")
        self._reader: BoardReader | None = None
        self.layout: BoardLayout = NO_LAYOUT
        self.moment = Moment(0, 0.0)
        self.frame = encode(self.moment, self.layout)
        self.history: deque[bytes] = deque(maxlen=HISTORY_S * RATE_HZ)
        self.trouble: str | None = "no face has answered yet"
        self.origins: tuple[str, ...] = ()
        self._origins_of: str | None = None
        self._must_find = control_path is None
        self.on_moment: list[Callable[[], None]] = []

    @property
    def status_age_s(self) -> float:
        """Seconds since the face answered; infinite before it has."""
        return self._clock() - self._status_s

    @property
    def answers(self) -> bool:
        """Whether the face has reported its status within the last second."""
        return self.trouble is None and self.status_age_s < STATUS_OLD_S + STATUS_EVERY_S

    def certainty(self) -> dict[str, Any]:
        """Return the age of the status; up: the face answers and its servo side ticks."""
        is_new = self.status_age_s < float("inf")
        return {
            "up": self.answers and not self.moment.servos_gone,
            "face_answers": self.answers,
            "servos_gone": self.moment.servos_gone,
            "speech_gone": self.moment.speech_gone,
            "age_s": round(self.status_age_s, 3) if is_new else None,
            "trouble": self.trouble,
        }

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Poll the face until the block ends."""
        tasks = [asyncio.create_task(each) for each in (self._look(), self._ask_status())]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.close()
            self._put_away()

    def look(self) -> None:
        """One tick: read what the face has written since the last."""
        now_s = self._clock()
        number, time_s = self.moment.number + 1, now_s - self._started_s
        if self._reader is None:
            self.moment = Moment(number, time_s)
        else:
            self.moment = self._reader.read(number, time_s, now_s)
        self.frame = encode(self.moment, self.layout)
        self.history.append(self.frame)
        for tell in self.on_moment:
            tell()

    async def located(self) -> Path:
        """Find the face anew, where none listens at `control_path`; it is kept there."""
        if self._locating is None or self._locating.done():
            self._locating = asyncio.create_task(self._located())
        return await asyncio.shield(self._locating)

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
                status = await self._returned(_requested_status, self._starting)
                states = set(dict(status.get("servos") or {}).values())
                if status.get("state") not in _ON_ITS_WAY or states == {"driven"}:
                    break
        known = {name: status.get(name) for name in ("state", "servos", "troubles")}
        return {"accepted": answer.get("accepted"), **known}

    async def interrupt(self) -> None:
        """Interrupt: drop all that the face says or plays."""
        async with self._speech_side() as face:
            await face.interrupt()

    async def change(self, values: Mapping[str, float]) -> Answer:
        """Change settings: all of them, or none."""
        if not values:
            raise FaceError("refused", "name at least one setting")
        for name, value in values.items():
            if not math.isfinite(value):
                raise FaceError("refused", f"{shown(name)}: {value} is no number to set")
        return await self._returned(lambda path: change_settings(path, dict(values)))

    async def servo(self, name: str, what: str) -> Answer:
        """Order one servo off, on or restarted."""
        if what not in set(ServoSwitch):
            raise FaceError("refused", f"{shown(what)}: there are off, on, reboot")
        return await self._returned(lambda path: switch_servo(path, name, ServoSwitch(what)))

    async def jog_arm(self) -> Answer:
        """Single servos may be moved by hand from now on; to be renewed within 3 s."""
        return await self._returned(arm_jog)

    async def jog(self, name: str, deg: float) -> Answer:
        """One servo to an angle of its joint, within its limits; renews."""
        if not math.isfinite(deg):
            raise FaceError("refused", f"{shown(name)}: {deg} is no angle")
        return await self._returned(lambda path: jog_servo(path, name, deg))

    async def jog_pulse(self, name: str, pulse_us: float) -> Answer:
        """One hobby servo to a pulse, in small steps beyond its limits, too; renews."""
        return await self._returned(lambda path: jog_pulse(path, name, pulse_us))

    async def jog_end(self) -> Answer:
        """The face goes on as before."""
        return await self._returned(end_jog)

    async def look_at(self, yaw_deg: float | None, pitch_deg: float | None = None) -> Answer:
        """Look there, yaw to its own left and pitch upwards; None: at nothing in particular."""
        if yaw_deg is None:
            return await self.change({"look_weight": 0.0})
        angles = {"look_yaw_deg": yaw_deg, "look_pitch_deg": pitch_deg or 0.0}
        return await self.change(with_expiry(angles, time.monotonic()))

    async def affect(self, valence: float, arousal: float, tau_s: float) -> Answer:
        """A mood, -1 to 1 each, which fades with the time constant `tau_s`."""
        mood = {"affect_valence": valence, "affect_arousal": arousal, "affect_tau_s": tau_s}
        return await self.change(with_expiry(mood, time.monotonic()))

    async def say(self, text: str) -> Answer:
        """A text, in the face's own voice."""
        async with self._speech_side() as face:
            return await face.say(text)

    async def play(self, file: str) -> Answer:
        """Play a sound file of the folder that the face plays from."""
        async with self._speech_side() as face:
            return await face.play(file)

    def close(self) -> None:
        """Nothing more is sent; what waits fails."""
        for pool in (self._finding, self._starting, self._others, self._asking):
            pool.shutdown(wait=False, cancel_futures=True)

    async def _located(self) -> Path:
        loop = asyncio.get_running_loop()
        try:
            self.control_path = await loop.run_in_executor(self._finding, self._find)
        except (OSError, UserError, ControlError) as error:
            raise not_answering(error) from error
        return self.control_path

    @contextlib.asynccontextmanager
    async def _speech_side(self) -> AsyncIterator[AsyncFace]:
        """The face's agent server, for one call. Raises FaceError."""
        url = (self.status or {}).get("listens_on")
        if url is None:
            hint = "it speaks when it was started by `lipservo daemon`, with --play"
            raise FaceError("not_available", f"the face takes no speech: {hint}")
        try:
            async with asyncio.timeout(_SAYING_S), AsyncFace(_reached(url), self._token) as face:
                yield face
        except TimeoutError as error:
            raise FaceError("not_answering", "the face's speech side does not answer") from error

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
        """Call the face where it was last, or else where it is by now; in a thread."""
        path = self.control_path
        try:
            if path is None:
                return call(self._find())
            try:
                return call(path)
            except (FileNotFoundError, ConnectionError):
                return call(self._find())
        except (OSError, UserError, ControlError) as error:
            raise not_answering(error) from error

    async def _look(self) -> None:
        due_s = self._clock()
        while True:
            self.look()
            due_s = max(due_s + 1.0 / RATE_HZ, self._clock())
            await asyncio.sleep(due_s - self._clock())

    async def _ask_status(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            began_s = self._clock()
            found = await loop.run_in_executor(self._asking, self._status_in_thread)
            self._take(*found)
            await asyncio.sleep(max(0.05, began_s + STATUS_EVERY_S - self._clock()))

    def _status_in_thread(self) -> tuple[dict[str, Any] | str, LiveBoard | None]:
        """The status, or why there is none; and a board, where one is needed."""
        try:
            path = self.control_path
            if path is None or self._must_find:
                path = self._find()
            answer = dict(_requested_status(path))
        except TimeoutError:
            return "the face hangs: it does not answer", None
        except (OSError, UserError, ControlError) as error:
            self._must_find = True  # a stop still goes where the face was last
            return " ".join(str(error).split()), None
        self.control_path, self._must_find = path, False
        self._read_origins(answer.get("config"))
        board = None
        if self._needs_board() and self._clock() - self._watched_s > _WATCH_EVERY_S:
            self._watched_s = self._clock()
            # A face that cannot be watched has a status all the same.
            with contextlib.suppress(OSError, ControlError, ValueError):
                board = LiveBoard.watch(watch(path))
        return answer, board

    def _read_origins(self, config: object) -> None:
        """Once for each face. A YAML that cannot be read any more lists none."""
        if config == self._origins_of or not isinstance(config, str):
            return
        try:
            origins = load_settings(config)[0].access.origins
        except (OSError, UserError):
            origins = ()
        self.origins, self._origins_of = origins, config

    def _needs_board(self) -> bool:
        return self._reader is None or (self.moment.servos_gone and self.moment.speech_gone)

    def _take(self, answer: dict[str, Any] | str, board: LiveBoard | None) -> None:
        if isinstance(answer, str):
            self.trouble = answer
        else:
            self.status, self.trouble, self._status_s = _plain_value(answer), None, self._clock()
        if board is not None:
            self._put_away()
            self._reader = BoardReader(board)
            if board.layout != self.layout:
                self.layout = board.layout
                self.history.clear()

    def _put_away(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


def not_answering(error: Exception) -> FaceError:
    """The error of a face that cannot be reached."""
    if isinstance(error, TimeoutError):
        why = "the face hangs; `lipservo stop --limp` lets its servos go"
    elif isinstance(error, PermissionError):
        why = "this user may not command the face"
    else:
        why = f"no face answers: {' '.join(str(error).split())}"
    return FaceError("not_answering", why)


def _requested_status(path: Path) -> Answer:
    return ask(path, "status", _STATUS_PATIENCE_S)


def _reached(url: str) -> str:
    """The URL for requests: a server at every address of this computer is reached at loopback."""
    split = urlsplit(url)
    if split.hostname in ("0.0.0.0", "::"):
        host = "127.0.0.1" if split.hostname == "0.0.0.0" else "[::1]"
        return f"{split.scheme}://{host}:{split.port}"
    return url


def _plain_value(value: Any) -> Any:
    """The same with nothing that is no number: JSON, as others read it, has no NaN."""
    if isinstance(value, dict):
        return {key: _plain_value(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_plain_value(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
