"""The dashboard's connection to a running face: its state, thirty times a second, and commands.

The dashboard is one client of a face. It reads memory that the face writes anyway, and polls the
face's status twice a second; if the dashboard hangs, no face does. Commands go to the face's
control socket and to its agent server. A stop is sent by `web/stop_route.py`, in the event loop, to
the control path that is kept here. Commands raise FaceError, one line, with a code of
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
from firmware_bridge.stopping import ServoSwitch, StopLevel
from lipservo.dashboard.live_frames import NO_LAYOUT, RATE_HZ, BoardReader, Snapshot, encode
from lipservo.runtime.servos.assembly import load_settings
from lipservo.runtime.speech.passing_wish import with_expiry
from lipservo.runtime.status.live_board import BoardLayout, LiveBoard
from lipsync.errors import UserError, shown

Answer = Mapping[str, Any]
#: For the answer to `say` and `play`, which comes before anything is spoken.
_SAYING_S: Final = 12.0
#: Stops that wait for the face's stop report; its control socket has room for 16 clients.
_MOST_WAITING: Final = 8
#: Between two statuses while a face is started.
_POLL_S: Final = 0.1
#: States of a face during a start; any other state means that the start has ended.
_STARTING_STATES: Final = ("the bridge starts", "the bridge starts again", "starting", "driven")
STATUS_EVERY_S: Final = 0.5
#: A status older than this is no longer shown as one.
STATUS_OLD_S: Final = 1.0
_STATUS_PATIENCE_S: Final = 1.0
#: A live board that is no longer written is opened anew so often: another face may have started.
_WATCH_EVERY_S: Final = 2.0
#: Seconds of frames kept for pages that are opened later.
HISTORY_S: Final = 30


class NothingDrivenError(UserError):
    """The error for a stop while no face runs. is_limp: the last servos confirmed torque off."""

    def __init__(self, text: str, *, is_limp: bool) -> None:
        super().__init__(text)
        self.is_limp = is_limp


class FaceLink:
    """A connection to one face. Its tasks run within `async with link.running()`.

    control_path: the face's present or last control socket: a stop is sent there without a search.
    layout: names of servos, states, phonemes, of the last face read. snapshot: the newest.
    status: the face's newest status, None before the first. trouble: why no status comes now; None:
    it comes. history: encoded frames of the last 30 s. on_snapshot: functions called after each new
    snapshot, 30 times a second. origins: web origins that the face's YAML allows.
    """

    def __init__(
        self,
        find: Callable[[], Path],
        token: str | None = None,
        control_path: Path | None = None,
        let_go: Callable[[], NothingDrivenError] | None = None,
    ) -> None:
        """Create the link; nothing is connected yet.

        find: returns the path of the face's control socket; called in a thread, may raise
        UserError, ControlError. token: for the face's agent server; None: the token is found if the
        face runs on this computer. control_path: the control socket, if it is known. let_go:
        ends a face that accepts no stop, and returns what its servos confirmed; called in a thread;
        None: only the face itself can switch its servos off.
        """
        self._find = find
        self._let_go = let_go
        self._token = token
        self._clock = time.monotonic
        self.control_path = control_path
        self.status: dict[str, Any] | None = None
        self._n_waiting = 0
        self._locating: asyncio.Task[Path] | None = None
        self._find_pool = ThreadPoolExecutor(1, thread_name_prefix="dashboard find")
        self._start_pool = ThreadPoolExecutor(2, thread_name_prefix="dashboard start")
        self._command_pool = ThreadPoolExecutor(2, thread_name_prefix="dashboard command")
        self._status_pool = ThreadPoolExecutor(1, thread_name_prefix="dashboard status")
        self._started_s = self._clock()
        self._status_at_s = float("-inf")
        self._board_tried_at_s = float("-inf")
        self._reader: BoardReader | None = None
        self.layout: BoardLayout = NO_LAYOUT
        self.snapshot = Snapshot(0, 0.0)
        self.frame = encode(self.snapshot, self.layout)
        self.history: deque[bytes] = deque(maxlen=HISTORY_S * RATE_HZ)
        self.trouble: str | None = "no face has answered yet"
        self.origins: tuple[str, ...] = ()
        self._origins_config: str | None = None
        self._must_find = control_path is None
        self.on_snapshot: list[Callable[[], None]] = []

    @property
    def status_age_s(self) -> float:
        """Seconds since the face's last status arrived; infinite before the first."""
        return self._clock() - self._status_at_s

    @property
    def answers(self) -> bool:
        """Whether the last status request was answered, at most 1.5 s ago."""
        return self.trouble is None and self.status_age_s < STATUS_OLD_S + STATUS_EVERY_S

    def certainty(self) -> dict[str, Any]:
        """Return, for JSON, how current the state is.

        up: the face answers and its servo side writes records. age_s: of the last status; None
        before the first. trouble: why no status comes; None: it comes.
        """
        has_answered = self.status_age_s < float("inf")
        return {
            "up": self.answers and not self.snapshot.servos_gone,
            "face_answers": self.answers,
            "servos_gone": self.snapshot.servos_gone,
            "speech_gone": self.snapshot.speech_gone,
            "age_s": round(self.status_age_s, 3) if has_answered else None,
            "trouble": self.trouble,
        }

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Read the face's state and poll its status until the block ends; then close the link."""
        tasks = [asyncio.create_task(each) for each in (self._run_snapshots(), self._poll_status())]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.close()
            self._close_board()

    def take_snapshot(self) -> None:
        """Take a new snapshot of the face, add its frame to the history, call all `on_snapshot`."""
        now_s = self._clock()
        number, time_s = self.snapshot.number + 1, now_s - self._started_s
        if self._reader is None:
            self.snapshot = Snapshot(number, time_s)
        else:
            self.snapshot = self._reader.read(number, time_s, now_s)
        self.frame = encode(self.snapshot, self.layout)
        self.history.append(self.frame)
        for on_snapshot in self.on_snapshot:
            on_snapshot()

    async def find_control_path(self) -> Path:
        """Find the face's control socket anew, store its path as `control_path`, and return it.

        Calls at the same time share one search. Raises FaceError if none is found, or
        NothingDrivenError if no servo is driven.
        """
        if self._locating is None or self._locating.done():
            self._locating = asyncio.create_task(self._find_socket())
        return await asyncio.shield(self._locating)

    async def release_unreached(self, error: Exception, level: StopLevel) -> NothingDrivenError:
        """Switch off the servos of a face that a stop did not reach; return what they confirmed.

        error: why the stop failed. A NothingDrivenError is returned as it is if the servos are limp
        already, or if nothing more can be done. Raises FaceError `not_answering` for other errors
        where only the face can switch its servos off, and for a freeze.
        """
        if isinstance(error, NothingDrivenError):
            if error.is_limp or self._let_go is None or level is StopLevel.FREEZE:
                return error
        elif self._let_go is None or level is StopLevel.FREEZE:
            raise error if isinstance(error, FaceError) else not_answering(error) from error
        return await asyncio.get_running_loop().run_in_executor(self._find_pool, self._let_go)

    @contextlib.contextmanager
    def waiting_for_end(self, wait_s: float) -> Iterator[float]:
        """Yield the seconds that a stop may wait for its stop report: `wait_s`, 0 if 8 others wait.

        Inside the block the stop counts as one that waits.
        """
        if not wait_s or self._n_waiting >= _MOST_WAITING:
            yield 0.0
            return
        self._n_waiting += 1
        try:
            yield wait_s
        finally:
            self._n_waiting -= 1

    async def start(self, wait_s: float = 0.0) -> Answer:
        """Start a stopped face; it moves. Raises FaceError.

        Parameters
        ----------
        wait_s : seconds to wait until the face is driven; 0: return once the start is accepted.

        Returns
        -------
        {"accepted": "start"}; with `wait_s` also `state`, `servos` and `troubles` of its status
        once every servo is driven, the start has ended otherwise, or `wait_s` is over.
        """
        answer = dict(await self._answer_to(start_face, self._start_pool))
        if not wait_s:
            return {"accepted": answer.get("accepted")}
        loop = asyncio.get_running_loop()
        give_up_s = loop.time() + wait_s
        status: Answer = {}
        while loop.time() < give_up_s:
            await asyncio.sleep(_POLL_S)
            with contextlib.suppress(FaceError):
                status = await self._answer_to(_get_status, self._start_pool)
                states = set(dict(status.get("servos") or {}).values())
                if status.get("state") not in _STARTING_STATES or states - {"off"} == {"driven"}:
                    break
        facts = {name: status.get(name) for name in ("state", "servos", "troubles")}
        return {"accepted": answer.get("accepted"), **facts}

    async def interrupt(self) -> None:
        """Drop all that the face is saying or playing. Raises FaceError."""
        async with self._speech_side() as face:
            await face.interrupt()

    async def change(self, values: Mapping[str, float]) -> Answer:
        """Change the face's settings to `values`, all or none; return its answer.

        Raises FaceError.
        """
        if not values:
            raise FaceError("refused", "no setting is named; name at least one")
        for name, value in values.items():
            if not math.isfinite(value):
                raise FaceError("refused", f"{shown(name)}: {value} is not a finite number")
        return await self._answer_to(lambda path: change_settings(path, dict(values)))

    async def servo(self, name: str, what: str) -> Answer:
        """Switch one servo off or on, or reboot it, by `what`; return the face's answer.

        what: `off`, `on` or `reboot`; any other word raises FaceError.
        """
        if what not in set(ServoSwitch):
            raise FaceError("refused", f"{shown(what)} is unknown; use off, on or reboot")
        return await self._answer_to(lambda path: switch_servo(path, name, ServoSwitch(what)))

    async def jog_arm(self) -> Answer:
        """Allow single servos to be moved by hand for 3 s, or renew that; return the answer."""
        return await self._answer_to(arm_jog)

    async def jog(self, name: str, deg: float) -> Answer:
        """Move one servo to a joint angle (deg) within its limits, and renew jogging for 3 s."""
        if not math.isfinite(deg):
            raise FaceError("refused", f"{shown(name)}: {deg} is not a finite angle")
        return await self._answer_to(lambda path: jog_servo(path, name, deg))

    async def jog_pulse(self, name: str, pulse_us: float) -> Answer:
        """Move a hobby servo to a pulse (us), in small steps beyond its limits; renew jogging."""
        return await self._answer_to(lambda path: jog_pulse(path, name, pulse_us))

    async def jog_end(self) -> Answer:
        """End jogging: moved servos return to the face's own goals."""
        return await self._answer_to(end_jog)

    async def look_at(self, yaw_deg: float | None, pitch_deg: float | None = None) -> Answer:
        """Aim the gaze at yaw (to the face's left) and pitch (up), in deg; None: at no target."""
        if yaw_deg is None:
            return await self.change({"look_weight": 0.0})
        angles = {"look_yaw_deg": yaw_deg, "look_pitch_deg": pitch_deg or 0.0}
        return await self.change(with_expiry(angles, time.monotonic()))

    async def affect(self, valence: float, arousal: float, tau_s: float) -> Answer:
        """Set a mood, -1 to 1 each, which fades with the time constant `tau_s` (s)."""
        mood = {"affect_valence": valence, "affect_arousal": arousal, "affect_tau_s": tau_s}
        return await self.change(with_expiry(mood, time.monotonic()))

    async def say(self, text: str, **voice: str | int) -> Answer:
        """Let the face speak a text in its own voice; return its answer once it is accepted.

        voice: language, voice, rate_wpm and pitch, where they differ from the face's YAML.
        """
        async with self._speech_side() as face:
            return await face.say(text, wait=False, **voice)

    async def play(self, file: str) -> Answer:
        """Play a sound file or performance of the face's folder; return the face's answer."""
        async with self._speech_side() as face:
            return await face.play(file)

    def close(self) -> None:
        """Send nothing more: waiting calls are cancelled, running ones are not waited for."""
        for pool in (self._find_pool, self._start_pool, self._command_pool, self._status_pool):
            pool.shutdown(wait=False, cancel_futures=True)

    async def _find_socket(self) -> Path:
        """Search for the face's control socket, in a thread; store and return its path.

        Raises NothingDrivenError, and FaceError `not_answering` if no face is found.
        """
        loop = asyncio.get_running_loop()
        try:
            self.control_path = await loop.run_in_executor(self._find_pool, self._find)
        except NothingDrivenError:
            raise
        except (OSError, UserError, ControlError) as error:
            raise not_answering(error) from error
        return self.control_path

    @contextlib.asynccontextmanager
    async def _speech_side(self) -> AsyncIterator[AsyncFace]:
        """Yield a client of the face's agent server, for one call. Raises FaceError."""
        url = (self.status or {}).get("listens_on")
        if url is None:
            cause = "it is starting, or was not started by `lipservo daemon` with --play"
            raise FaceError("not_available", f"the face takes no speech now: {cause}")
        try:
            async with asyncio.timeout(_SAYING_S), AsyncFace(_client_url(url), self._token) as face:
                yield face
        except TimeoutError as error:
            raise FaceError("not_answering", "the face's speech process does not answer") from error

    async def _answer_to(
        self, call: Callable[[Path], Answer], pool: ThreadPoolExecutor | None = None
    ) -> Answer:
        """Return the face's answer to `call`, which gets the path of its control socket.

        pool: of the thread that runs it; None: the threads of commands. Raises FaceError if the
        face refuses, or none answers.
        """
        loop = asyncio.get_running_loop()
        answer = await loop.run_in_executor(pool or self._command_pool, partial(self._call, call))
        if "error" in answer:
            raise FaceError("refused", str(answer["error"]))
        return answer

    def _call(self, call: Callable[[Path], Answer]) -> Answer:
        """Return the result of `call` with the last known control socket, or one found anew.

        Raises FaceError if no face answers. Blocks: to be called in a thread.
        """
        path = self.control_path
        try:
            with contextlib.suppress(FileNotFoundError, ConnectionError):
                if path is not None:
                    return call(path)
            return call(self._find())
        except (OSError, UserError, ControlError) as error:
            raise not_answering(error) from error

    async def _run_snapshots(self) -> None:
        """Call `take_snapshot` 30 times a second; those that a busy loop missed are left out."""
        due_s = self._clock()
        while True:
            self.take_snapshot()
            due_s = max(due_s + 1.0 / RATE_HZ, self._clock())
            await asyncio.sleep(due_s - self._clock())

    async def _poll_status(self) -> None:
        """Store the face's status, and its live board when needed, every 0.5 s, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            began_s = self._clock()
            answer_and_board = await loop.run_in_executor(self._status_pool, self._status_and_board)
            self._store_status(*answer_and_board)
            await asyncio.sleep(max(0.05, began_s + STATUS_EVERY_S - self._clock()))

    def _status_and_board(self) -> tuple[dict[str, Any] | str, LiveBoard | None]:
        """Return the face's status, or a line why there is none, and a newly opened live board.

        The board is None while the present one is written, and if none can be opened. Blocks:
        called in a thread.
        """
        try:
            path = self.control_path
            if path is None or self._must_find:
                path = self._find()
            answer = dict(_get_status(path))
        except TimeoutError:
            return "the face hangs: it does not answer", None
        except (OSError, UserError, ControlError) as error:
            self._must_find = True  # a stop still goes where the face was last
            return " ".join(str(error).split()), None
        self.control_path, self._must_find = path, False
        self._read_origins(answer.get("config"))
        board = None
        if self._needs_board() and self._clock() - self._board_tried_at_s > _WATCH_EVERY_S:
            self._board_tried_at_s = self._clock()
            # A face that cannot be watched has a status all the same.
            with contextlib.suppress(OSError, ControlError, ValueError):
                board = LiveBoard.watch(watch(path))
        return answer, board

    def _read_origins(self, config: object) -> None:
        """Store the web origins that the face's YAML at path `config` allows.

        The YAML read last is not read again; one that cannot be read allows none.
        """
        if config == self._origins_config or not isinstance(config, str):
            return
        try:
            origins = load_settings(config)[0].access.origins
        except (OSError, UserError):
            origins = ()
        self.origins, self._origins_config = origins, config

    def _needs_board(self) -> bool:
        """Return whether there is no live board, or none that is still written."""
        return self._reader is None or (self.snapshot.servos_gone and self.snapshot.speech_gone)

    def _store_status(self, answer: dict[str, Any] | str, board: LiveBoard | None) -> None:
        """Store the newest status and a newly opened live board.

        answer: the status, or a line why there is none. board: None: the present one stays. If its
        layout is new, the history of frames is cleared.
        """
        if isinstance(answer, str):
            self.trouble = answer
        else:
            self.status, self.trouble, self._status_at_s = _json_value(answer), None, self._clock()
        if board is not None:
            self._close_board()
            self._reader = BoardReader(board)
            if board.layout != self.layout:
                self.layout = board.layout
                self.history.clear()

    def _close_board(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


def not_answering(error: Exception) -> FaceError:
    """Return the FaceError `not_answering`, in words that fit the `error` of a failed call."""
    if isinstance(error, TimeoutError):
        why = "the face hangs; `lipservo stop --limp` lets its servos go"
    elif isinstance(error, PermissionError):
        why = "this user may not command the face"
    else:
        why = f"no face answers: {' '.join(str(error).split())}"
    return FaceError("not_answering", why)


def _get_status(path: Path) -> Answer:
    return ask(path, "status", _STATUS_PATIENCE_S)


def _client_url(url: str) -> str:
    """Return the URL to connect to: a server bound to all addresses is reached at loopback."""
    split = urlsplit(url)
    if split.hostname in ("0.0.0.0", "::"):
        host = "127.0.0.1" if split.hostname == "0.0.0.0" else "[::1]"
        return f"{split.scheme}://{host}:{split.port}"
    return url


def _json_value(value: Any) -> Any:
    """Return a value with NaN and infinity replaced by None at every depth, as JSON needs it."""
    if isinstance(value, dict):
        return {key: _json_value(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_json_value(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
