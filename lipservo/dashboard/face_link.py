"""The dashboard's hold on a running face: what it is told, thirty times a second, and commands.

The dashboard is a client of a face like any other. What it reads is memory that the face writes
anyway, and a status that it asks for twice a second; if all of it hangs, no face does.
"""

import asyncio
import contextlib
import math
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from firmware_bridge.process.control_client import ask, watch
from firmware_bridge.process.runtime_folder import ControlError
from lipservo.dashboard.face_commands import FaceCommands
from lipservo.dashboard.moments import NO_LAYOUT, BoardReader, Moment
from lipservo.dashboard.twin_frame import RATE_HZ, encode
from lipservo.face.assembly import load_settings
from lipservo.status.live_board import BoardLayout, LiveBoard
from lipsync.errors import UserError

STATUS_EVERY_S: Final = 0.5
#: A status older than this is no longer shown as one.
STATUS_OLD_S: Final = 1.0
_STATUS_PATIENCE_S: Final = 1.0
#: A board that nobody writes is asked for anew so often: another face may listen there by now.
_WATCH_EVERY_S: Final = 2.0
#: For pages that join late.
HISTORY_S: Final = 30


class FaceLink(FaceCommands):
    """One face, seen and commanded. Its tasks run within `async with link.running()`.

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
        super().__init__(find, token, control_path)
        self._clock = clock
        self._started_s = clock()
        self._status_s = float("-inf")
        self._watched_s = float("-inf")
        self._reader: BoardReader | None = None
        self._asking = ThreadPoolExecutor(1, thread_name_prefix="dashboard status")
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
        """Whether the face has said within the last second how it is."""
        return self.trouble is None and self.status_age_s < STATUS_OLD_S + STATUS_EVERY_S

    @property
    def servos_gone(self) -> bool:
        """The side that drives the servos has told nothing for a while."""
        return self.moment.servos_gone

    @property
    def speech_gone(self) -> bool:
        """The side that hears has told nothing for a while."""
        return self.moment.speech_gone

    def certainty(self) -> dict[str, Any]:
        """How sure what is known is; up: the face answers and its servo side ticks."""
        is_new = self.status_age_s < float("inf")
        return {
            "up": self.answers and not self.servos_gone,
            "face_answers": self.answers,
            "servos_gone": self.servos_gone,
            "speech_gone": self.speech_gone,
            "age_s": round(self.status_age_s, 3) if is_new else None,
            "trouble": self.trouble,
        }

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Look and ask until the block ends."""
        tasks = [asyncio.create_task(each) for each in (self._look(), self._ask_status())]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.close()
            self._asking.shutdown(wait=False, cancel_futures=True)
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
            answer = ask(path, "status", _STATUS_PATIENCE_S)
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
            self.status, self.trouble, self._status_s = _told(answer), None, self._clock()
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


def _told(value: Any) -> Any:
    """The same with nothing that is no number: JSON, as others read it, has no NaN."""
    if isinstance(value, dict):
        return {key: _told(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_told(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
