"""A face as the audio output of a LiveKit agent: `session.output.audio = face`.

Needs the extra `livekit`.
"""

import asyncio
import logging
import time
from collections.abc import Coroutine, Iterator
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, Final, Self

from livekit import rtc
from livekit.agents import AgentSession, ConversationItemAddedEvent
from livekit.agents.types import NOT_GIVEN, USERDATA_TIMED_TRANSCRIPT
from livekit.agents.utils import is_given
from livekit.agents.voice import SpeechHandle
from livekit.agents.voice.io import AudioOutput, AudioOutputCapabilities

from lipservo_client.async_face import AsyncFace, AsyncSpeech
from lipservo_client.heard import SpokenWords
from lipservo_client.protocol import FaceError, mono_pcm

_LOG: Final = logging.getLogger(__name__)


@dataclass(slots=True)
class _Turn:
    """The speech of a LiveKit speech handle, in one or more segments, until its text is stored.

    n_samples: of its sound; n_played: how many of them were played. has_words: some words came with
    the sound. is_cut: not all of it was played.
    """

    handle: SpeechHandle | None
    n_samples: int = 0
    n_played: int = 0
    has_words: bool = False
    is_cut: bool = False


class LiveKitFace(AudioOutput):
    """An audio output that plays an `AgentSession`'s speech on a face; it can pause.

    The session remembers the words that people heard. Enter the face before the session starts.
    While no face answers, or another client speaks through it, nothing is heard: the turn ends as
    interrupted, and a warning is logged; a face that comes back is used from the next segment on.
    """

    def __init__(self, url: str = "ws://127.0.0.1:8765", token: str | None = None) -> None:
        """Prepare the output for the face at `url`. token: as of `lipservo.connect`."""
        super().__init__(label="lipservo", capabilities=AudioOutputCapabilities(pause=True))
        self._face = AsyncFace(url, token)
        self._speech: AsyncSpeech | None = None
        self._turn = _Turn(None)
        self._words = SpokenWords(1)
        # Whether the present segment was cut off, so that its rest, until `flush`, is dropped.
        self._is_cut_off = False
        self._is_paused = False
        self._face_tasks: set[asyncio.Task[None]] = set()
        self._last_call: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        """Connect to the face; go on trying in the background if no face answers."""
        try:
            await self._face.__aenter__()
        except FaceError:
            self._face.keep_trying()
        self._start_task(self._follow_events())
        return self

    async def __aexit__(self, *exc: object) -> None:
        """Disconnect; segments that are not over end as interrupted."""
        await self._face.__aexit__()
        tasks = list(self._face_tasks)
        if tasks:  # they end by themselves, and report
            await asyncio.wait(tasks, timeout=1.0)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def capture_frame(self, frame: rtc.AudioFrame) -> None:
        """Send a frame of sound to the face, waiting while 30 s are unplayed.

        Frames of a segment that was cut off, or that no face accepts, are dropped.
        """
        await super().capture_frame(frame)
        if self._is_cut_off:
            return
        try:
            speech = self._speech or await self._start_stream(frame.sample_rate)
            for text, start in _frame_words(frame):
                self._turn.has_words = True
                self._words.add(text, start)
                if word := text.strip():
                    await speech.tell(text if start is None else ("words", [(word, start)]))
            self._words.n_samples += frame.samples_per_channel
            self._is_cut_off = not await speech.write(mono_pcm(frame.data, frame.num_channels))
        except (FaceError, asyncio.CancelledError) as error:
            self._is_cut_off = True
            if self._speech is None:  # its stream did not start, so no task reports its end
                self._report(self._turn, self._words, 0, is_whole=False)
            if isinstance(error, asyncio.CancelledError):  # barge-in
                raise
            _LOG.warning("not said: %s", error)

    async def _start_stream(self, rate_hz: int) -> AsyncSpeech:
        """Start a stream for a new segment, after earlier calls were sent, and return it.

        A task then waits for its end. Raises FaceError.
        """
        self._note_context()
        self._words = SpokenWords(rate_hz)
        if self._last_call is not None:
            await asyncio.wait([self._last_call])
        await self._face.try_now()
        speech = self._face.stream(rate_hz)
        await speech.__aenter__()
        self._speech = speech
        self._start_task(self._report_when_over(speech, self._turn, self._words))
        if self._is_paused:
            await self._face.pause()
        return speech

    def _note_context(self) -> None:
        """Store the speech handle of the segment that begins, and listen to its session.

        LiveKit calls `capture_frame` in a task whose context variables contain both.
        """
        values = list(copy_context().values())
        handle = next((each for each in values if isinstance(each, SpeechHandle)), None)
        if handle is None or handle is not self._turn.handle:
            self._turn = _Turn(handle)
        for session in (getattr(each, "session", None) for each in values):
            if isinstance(session, AgentSession):
                session.on("conversation_item_added", self._cut_to_heard)  # once, however often

    def flush(self) -> None:
        """Mark the current segment of the agent's speech as complete; it is played to its end."""
        super().flush()
        speech, self._speech, self._is_cut_off = self._speech, None, False
        if speech is not None:
            self._run_in_order(speech.end())

    def clear_buffer(self) -> None:
        """Interrupt the face at once; drop the rest of the agent's current segment of speech."""
        self._is_cut_off = self._is_cut_off or self._speech is not None
        if self._face.is_connected:
            self._run_in_order(self._face.interrupt())

    def pause(self) -> None:
        """Silence the face now; unplayed speech is kept, up to a minute, until `resume`."""
        super().pause()
        self._is_paused = True
        if self._is_saying:
            self._run_in_order(self._face.pause())

    def resume(self) -> None:
        """Resume speech that `pause` silenced."""
        super().resume()
        self._is_paused = False
        if self._is_saying:
            self._run_in_order(self._face.resume())

    @property
    def _is_saying(self) -> bool:
        return self._face.is_connected and self._pending_playback_count > 0

    async def _report_when_over(self, speech: AsyncSpeech, turn: _Turn, words: SpokenWords) -> None:
        """Wait until a stream is played or cut off, and report that to the session."""
        with suppress(FaceError):
            await speech.heard()
        self._report(turn, words, speech.n_played, is_whole=speech.was_heard)

    def _report(self, turn: _Turn, words: SpokenWords, n_played: int, *, is_whole: bool) -> None:
        """Report to the session that a segment is over, and which of its words were heard.

        n_played: samples. is_whole: played to the end; otherwise the turn counts as interrupted.
        """
        turn.n_samples += words.n_samples
        turn.n_played += n_played
        # Without words beside the sound, `_cut_to_heard` estimates later which words were heard.
        is_known = not is_whole and (turn.has_words or n_played == 0)
        if not is_whole:
            turn.is_cut = True
            if turn.handle is not None:
                # Unless a turn is interrupted, LiveKit stores all of its text, whatever was heard.
                turn.handle.interrupt(force=True)
        self.on_playback_finished(
            playback_position=n_played / words.rate_hz,
            interrupted=not is_whole,
            synchronized_transcript="".join(words.heard(n_played)) if is_known else None,
        )

    def _cut_to_heard(self, event: ConversationItemAddedEvent) -> None:
        """Cut an interrupted message of the session to what was heard.

        Only where no words came with the sound; otherwise `_report` has reported them.
        """
        item, turn = event.item, self._turn
        if item.type != "message" or item.role != "assistant":
            return
        if item.interrupted and turn.is_cut and not turn.has_words:
            words = SpokenWords(self._words.rate_hz, turn.n_samples)
            words.add(item.raw_text_content or "")
            item.content = list(words.heard(turn.n_played))
        self._turn = _Turn(turn.handle)

    async def _follow_events(self) -> None:
        async for event in self._face.events():
            if event["type"] == "started":
                self.on_playback_started(created_at=time.time())

    def _start_task(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._face_tasks.add(task)
        task.add_done_callback(self._face_tasks.discard)
        return task

    def _run_in_order(self, work: Coroutine[Any, Any, object]) -> None:
        """Start a task that runs `work` once the work of the call before is done.

        So the end of a stream is sent before an interruption that was requested after it.
        """
        earlier_call = self._last_call

        async def run() -> None:
            if earlier_call is not None:
                await asyncio.wait([earlier_call])
            with suppress(FaceError):
                await work

        self._last_call = self._start_task(run())


def _frame_words(frame: rtc.AudioFrame) -> Iterator[tuple[str, int | None]]:
    """Yield the words that the synthesiser sent with a frame's sound, as (word, start sample).

    Samples count from the beginning of the segment; None: not known.
    """
    for word in frame.userdata.get(USERDATA_TIMED_TRANSCRIPT, ()):
        start_s = getattr(word, "start_time", NOT_GIVEN) if word.strip() else NOT_GIVEN
        start = max(0, round(start_s * frame.sample_rate)) if is_given(start_s) else None
        yield str(word), start
