"""A face in a Pipecat pipeline: as its loudspeaker, or following a transport's sound.

`PipecatFace` plays the sound of the TTS service; `PipecatFollower` moves the lips to sound that a
transport plays. Needs the extra `pipecat`. docs/agents.md has the frames as a table.
"""

import asyncio
from collections import deque
from collections.abc import Coroutine
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Final

from pipecat.frames import frames
from pipecat.processors.frame_processor import FrameCallback, FrameDirection, FrameProcessor

from lipservo_client.async_face import AsyncFace, AsyncSpeech
from lipservo_client.heard import SpokenWords
from lipservo_client.protocol import Event, FaceError, Played, error_of, mono_pcm

#: Sentences that are announced before any of their sound came; the oldest are left out.
_MOST_UNTOLD: Final = 64
#: Between two questions for the position while frames wait for their sound.
_ASKING_S: Final = 0.05
#: An interruption holds the pipeline up no longer.
_INTERRUPTING_S: Final = 1.0
#: A frame passes a processor in two or three turns of the event loop. What was heard is in the
#: context of an aggregator up to twenty processors behind, before the interruption clears queues.
_SETTLING_PASSES: Final = 64
#: Between two reports of what a transport has played.
_REPORT_S: Final = 0.1
#: In the metadata of a context's first sound: the time in ns from which Pipecat times its words.
_TIMED_FROM: Final = "lipservo_timed_from_ns"


class _FaceProcessor(FrameProcessor):
    """A frame processor that connects to a face at the start, and again after every loss."""

    def __init__(self, url: str, token: str | None) -> None:
        super().__init__()
        self._face = AsyncFace(url, token)
        self._tasks: list[asyncio.Task[None]] = []

    async def cleanup(self) -> None:
        """Cancel the processor's tasks and disconnect from the face."""
        await super().cleanup()
        for task in self._tasks:
            await self.cancel_task(task)
        await self._face.__aexit__()

    async def _connect(self, *working: Coroutine[Any, Any, None]) -> None:
        """Connect to the face, and run the `working` coroutines until the pipeline ends."""
        self._tasks = [self.create_task(each) for each in working]
        try:
            await self._face.__aenter__()
        except FaceError as error:
            await self._complain(error)
            self._face.keep_trying()

    async def _complain(self, error: Exception) -> None:
        await self.push_error(f"the face: {error}", exception=error)

    async def _interrupted(self) -> Played | None:
        try:
            async with asyncio.timeout(_INTERRUPTING_S):
                return await self._face.interrupt()
        except (FaceError, TimeoutError) as error:
            await self._complain(error)
            return None


@dataclass(slots=True)
class _Unheard:
    """A frame in the order of speech; it waits until sample `n` of its stream was played.

    Frames of sound are dropped then, others pushed. speech: None: the frame follows no speech.
    words, piece: of a spoken text, the words of its stream, and its number among them. is_timed: n
    is where a word begins, and the frame waits until that word counts as heard; otherwise n is
    behind all sound before the frame.
    """

    speech: AsyncSpeech | None
    n: int
    frame: frames.Frame
    words: SpokenWords
    piece: int | None = None
    is_timed: bool = False

    @property
    def is_sound(self) -> bool:
        return isinstance(self.frame, frames.TTSAudioRawFrame)

    @property
    def is_heard(self) -> bool:
        speech = self.speech
        if speech is None or speech.was_heard:
            return True
        if self.is_timed:
            return self._heard_text(speech) == str(self.frame.text)
        return speech.n_played >= self.n

    @property
    def may_go_on(self) -> bool:
        """Whether the frame's turn has come: its sound was played.

        A frame that is no sound also waits until the stream is over, once its end was sent.
        """
        is_last = self.speech is not None and self.speech.is_complete and not self.speech.is_over
        return self.is_heard and (self.is_sound or not is_last)

    @property
    def is_lost(self) -> bool:
        """Whether the frame's sound will never be played, because the stream was cut off."""
        return self.speech is not None and self.speech.is_over and not self.is_heard

    def as_heard(self) -> frames.Frame | None:
        """Return the frame, of a spoken text the words that were heard; None for sound or none."""
        if self.is_sound:
            return None
        if self.speech is None or self.is_heard:
            return self.frame
        if not isinstance(self.frame, frames.TextFrame):
            return self.frame if self.speech.is_over else None
        if not (text := self._heard_text(self.speech)).strip():
            return None
        heard = copy(self.frame)
        heard.text, heard.raw_text = text, None
        return heard

    def _heard_text(self, speech: AsyncSpeech) -> str:
        if self.piece is None:
            return ""
        is_complete = speech.is_complete
        return self.words.part(self.piece, speech.n_played, is_complete=is_complete)


class PipecatFace(_FaceProcessor):
    """A processor behind the TTS service that plays its sound on a face instead of a transport.

    Frames behind sound go on when the sound was played, so that the context contains what a person
    heard. While no face answers, an error is pushed and the sound goes on to the transport, until
    the face is back and the transport has played it. last_played: how much of the speech was played
    at the last interruption; None: no speech was cut off, or it is not known.
    """

    def __init__(self, url: str = "ws://127.0.0.1:8765", token: str | None = None) -> None:
        super().__init__(url, token)
        self._speech: AsyncSpeech | None = None
        self._n = 0
        self._line: list[_Unheard] = []
        self._releasing = asyncio.Lock()
        self._words = SpokenWords(1)
        #: The sample behind the last sentence: the next one's sound begins there.
        self._n_spoken = 0
        #: Of a TTS context: the sample, and the time in ns, from which its words are timed. As
        #: Pipecat has it, that is when its sound came, or the last word before if that is later.
        self._contexts: dict[str | None, tuple[int, int]] = {}
        self._last_word_ns = 0
        self._open_contexts: set[str | None] = set()
        self._has_loudspeaker = True
        #: Sentences whose sound has not begun; and whether the service announces its sentences, so
        #: that the same words come again as they were said.
        self._untold: list[str] = []
        self._is_announced = False
        self._is_speaking = False
        self._is_complete = False
        #: Nothing more of what is being said is wanted: it was cut off at the face.
        self._is_cut = False
        self._transport_until_s = 0.0
        self.last_played: Played | None = None

    async def queue_frame(
        self,
        frame: frames.Frame,
        direction: FrameDirection = FrameDirection.DOWNSTREAM,
        callback: FrameCallback | None = None,
    ) -> None:
        """Queue a frame; note when its sound left the service, which is when words are timed from.

        A frame may wait here for long, until the face takes more sound.
        """
        if isinstance(frame, frames.InterruptionFrame):
            self._last_word_ns = 0
            self._open_contexts.clear()
        elif direction == FrameDirection.DOWNSTREAM:
            self._note_time(frame)
        await super().queue_frame(frame, direction, callback)

    def _note_time(self, frame: frames.Frame) -> None:
        """Write into a context's first sound the time, in ns, from which its words are timed."""
        if isinstance(frame, frames.TTSAudioRawFrame):
            if frame.context_id not in self._open_contexts:
                self._open_contexts.add(frame.context_id)
                frame.metadata[_TIMED_FROM] = max(self._last_word_ns, self.get_clock().get_time())
        elif isinstance(frame, frames.TTSStoppedFrame):
            self._open_contexts.discard(frame.context_id)
        elif isinstance(frame, frames.TTSTextFrame) and frame.pts:
            self._last_word_ns = max(self._last_word_ns, frame.pts)

    async def process_frame(self, frame: frames.Frame, direction: FrameDirection) -> None:
        """Send sound to the face; push other frames once the sound before them was played.

        System frames, and frames that go upstream, are pushed at once.
        """
        await super().process_frame(frame, direction)
        if isinstance(frame, frames.StartFrame):
            await self._connect(self._follow(), self._ask_positions())
        elif isinstance(frame, (frames.InterruptionFrame, frames.CancelFrame)):
            await self._interrupt(everything=isinstance(frame, frames.CancelFrame))
        elif not isinstance(frame, frames.SystemFrame) and direction == FrameDirection.DOWNSTREAM:
            await self._take(frame)
            return
        await self.push_frame(frame, direction)

    async def _take(self, frame: frames.Frame) -> None:
        """Send a frame's sound or text to the face, and let the frame wait for the sound before it.

        Text of a turn that was cut off at the face is dropped.
        """
        if isinstance(frame, frames.TTSAudioRawFrame):
            await self._say(frame)
            return
        if self._is_cut and isinstance(frame, frames.TextFrame):
            return
        if isinstance(frame, frames.AggregatedTextFrame):
            await self._tell(frame)
        self._wait_in_line(frame)
        if isinstance(frame, frames.TTSStoppedFrame):
            self._is_complete, self._is_cut = True, False
            if self._speech is not None:
                # Or the face waits for what its last block lacks, and that for the end.
                with suppress(FaceError):
                    await self._speech.mark("said")
        # An interruption cancels this task; what was heard goes on nevertheless.
        await asyncio.shield(self._release())

    async def _say(self, frame: frames.TTSAudioRawFrame) -> None:
        """Send a frame of sound to the face, waiting while 30 s are unplayed; or push it.

        The frame is pushed, for the transport to play, while no face with a loudspeaker is
        connected, and until the transport has played what was pushed. It is dropped if the turn was
        cut off at the face.
        """
        now_s = asyncio.get_running_loop().time()
        seconds = len(frame.audio) / (2 * frame.num_channels * frame.sample_rate)
        self._is_complete = False
        if self._is_cut:
            return
        is_faces = self._face.is_connected and self._has_loudspeaker
        if self._speech is None and (now_s < self._transport_until_s or not is_faces):
            self._transport_until_s = max(now_s, self._transport_until_s) + seconds
            await self.push_frame(frame)
            return
        pcm = mono_pcm(frame.audio, frame.num_channels)
        try:
            speech = await self._stream(frame.sample_rate)
            if _TIMED_FROM in frame.metadata:
                self._contexts[frame.context_id] = (self._n, frame.metadata[_TIMED_FROM])
            self._n += len(pcm) // 2
            self._words.extend(len(pcm) // 2)
            self._line.append(_Unheard(speech, self._n, frame, self._words))
            untold, self._untold = self._untold, []
            for text in untold:
                await speech.tell(text)
            self._is_cut = not await speech.write(pcm)
        except FaceError as error:
            await self._complain(error)
            if error.code == "no_loudspeaker":
                self._speech, self._has_loudspeaker = None, False
                return await self._say(frame)
            self._is_cut = True
        if self._is_cut:
            await asyncio.shield(self._release())

    async def _stream(self, rate_hz: int) -> AsyncSpeech:
        """Return this turn's open stream; a new one for a new turn or rate. Raises FaceError."""
        speech = self._speech
        if speech is not None and speech.rate_hz != rate_hz:
            await speech.end()
            speech = None
        if speech is None:
            speech = self._face.stream(rate_hz)
            self._speech, self._n, self._n_spoken = speech, 0, 0
            self._words = SpokenWords(rate_hz)
            self._contexts.clear()
            await speech.__aenter__()
        return speech

    async def _tell(self, frame: frames.AggregatedTextFrame) -> None:
        """Send a frame's text to the face: words with times, or sentences before their sound."""
        is_spoken = isinstance(frame, frames.TTSTextFrame)
        n = self._sample_of(frame)
        text = frame.text.strip()
        if not text or not (is_spoken or frame.will_be_spoken):
            return
        self._is_announced = self._is_announced or not is_spoken
        if n is None and is_spoken and self._is_announced:
            return
        if self._speech is None:
            self._untold = [*self._untold, text][-_MOST_UNTOLD:]
            return
        with suppress(FaceError):
            await self._speech.tell(text if n is None else ("words", [(text, n)]))

    def _sample_of(self, frame: frames.Frame) -> int | None:
        """Return the sample of the stream at which a word, `frame`, is spoken.

        None for a word without a time, a frame that is no text, or while no stream is open.
        """
        speech = self._speech
        context = self._contexts.get(getattr(frame, "context_id", None))
        is_word = isinstance(frame, frames.TextFrame) and frame.pts and frame.text.strip()
        if speech is None or context is None or not is_word:
            return None
        since_s = 1e-9 * (frame.pts - context[1])
        return max(0, int(context[0] + round(since_s * speech.rate_hz)))

    def _wait_in_line(self, frame: frames.Frame) -> None:
        """Queue a frame until its sound was played: at its time, or behind all sound so far."""
        speech = self._speech or (self._line[-1].speech if self._line else None)
        n = self._sample_of(frame)
        words, piece = self._words, None
        if n is not None:
            place = len(self._line)
            while place and self._line[place - 1].speech is speech and self._line[place - 1].n > n:
                place -= 1
            piece = words.add(frame.text, n)
            self._line.insert(place, _Unheard(speech, n, frame, words, piece, is_timed=True))
            return
        n = self._n if speech is self._speech else self._line[-1].n
        for each in self._line:
            each.n = min(each.n, n) if each.speech is speech else each.n
        if isinstance(frame, frames.TTSTextFrame) and self._speech is not None:
            piece = words.add(frame.text, self._n_spoken, n)
            self._n_spoken = n
        self._line.append(_Unheard(speech, n, frame, words, piece))

    async def _release(self) -> None:
        """Push the waiting frames whose sound was played; drop text that will never be spoken."""
        async with self._releasing:
            speech = self._speech
            if self._is_complete and all(each.is_heard for each in self._line if each.is_sound):
                await self._end()
            while self._line and (self._line[0].may_go_on or self._line[0].is_lost):
                if (heard := self._line.pop(0).as_heard()) is not None:
                    await self.push_frame(heard)
            if speech is not None and speech.is_over:
                self._is_cut = not (speech.was_heard or self._is_complete)
                await self._end()
            if self._speech is None and not self._line:
                await self._tell_speaking(False)

    async def _end(self) -> None:
        speech, self._speech = self._speech, None
        if speech is not None:
            with suppress(FaceError):
                await speech.end()

    async def _tell_speaking(self, is_speaking: bool) -> None:
        """Broadcast that the bot starts or stops speaking, unless that was broadcast last."""
        if is_speaking != self._is_speaking:
            self._is_speaking = is_speaking
            kind = frames.BotStartedSpeakingFrame if is_speaking else frames.BotStoppedSpeakingFrame
            await self.broadcast_frame(kind)

    async def _interrupt(self, *, everything: bool) -> None:
        """Interrupt the face, push the frames already played, and send uninterruptible ones again.

        everything: uninterruptible frames are dropped too.
        """
        async with self._releasing:
            sound = [each for each in self._line if each.is_sound and not each.is_heard]
            kept = [each for each in sound if not (each.frame.interruptible or everything)]
            is_spoken = bool(sound) or self._speech is not None
            is_cut = is_spoken and self._face.is_connected and (not kept or len(kept) < len(sound))
            self.last_played = await self._interrupted() if is_cut else None
            line, self._line = self._line, []
            again: list[_Unheard] = []
            for each in line:
                is_kept = each.is_heard or isinstance(each.frame, frames.TextFrame)
                if not (each.is_heard or each.frame.interruptible or everything):
                    (again if is_cut else self._line).append(each)
                elif is_kept and (heard := each.as_heard()) is not None:
                    await self.push_frame(heard)
            self._is_cut, self._transport_until_s = False, 0.0
            self._untold.clear()
            self._speech = None if is_cut else self._speech
        for _ in range(_SETTLING_PASSES):
            await asyncio.sleep(0.0)
        for each in again:
            await self._take(_rest_of(each) if each.is_sound else each.frame)
        await self._release()

    async def _follow(self) -> None:
        async for event in self._face.events():
            await self._hear(event)

    async def _hear(self, event: Event) -> None:
        """Push frames whose sound was played; broadcast the bot's speaking, and report a loss."""
        if event["type"] == "disconnected":
            self._has_loudspeaker = True  # the next may have one
            await self._complain(error_of(event))
        if self._speech is not None and event.get("stream") == self._speech.stream:
            if event["type"] == "started":
                await self._tell_speaking(True)
            elif event["type"] == "position" and self._is_speaking:
                await self.broadcast_frame(frames.BotSpeakingFrame)
        await self._release()

    async def _ask_positions(self) -> None:
        while True:
            await asyncio.sleep(_ASKING_S)
            if self._face.is_connected and any(not each.is_sound for each in self._line):
                with suppress(FaceError):
                    await self._face.wire.send("position")


class PipecatFollower(_FaceProcessor):
    """A processor before an output transport that moves a face's lips to the transport's sound.

    For robots whose sound is WebRTC or a telephone line. Sound goes to the face at once and to the
    transport later by the face's delay; the lips follow the transport's reports of what it plays.
    All other frames keep their order.
    """

    def __init__(self, url: str = "ws://127.0.0.1:8765", token: str | None = None) -> None:
        super().__init__(url, token)
        self._speech: AsyncSpeech | None = None
        #: (when it goes on, frame), and the streams that the transport has not played.
        self._line: deque[tuple[float, frames.Frame]] = deque()
        self._unplayed: deque[AsyncSpeech] = deque()
        self._came = asyncio.Event()
        self._began_s: float | None = None

    async def process_frame(self, frame: frames.Frame, direction: FrameDirection) -> None:
        """Send sound to the face, and push frames later, by the face's delay.

        System frames, and frames that go upstream, are pushed at once.
        """
        await super().process_frame(frame, direction)
        now_s = asyncio.get_running_loop().time()
        if isinstance(frame, frames.StartFrame):
            await self._connect(self._hand_on(), self._report())
        elif isinstance(frame, (frames.InterruptionFrame, frames.CancelFrame)):
            self._line = deque(each for each in self._line if not each[1].interruptible)
            self._speech, self._began_s = None, None
            self._unplayed.clear()
            if self._face.is_connected:
                await self._interrupted()
        elif isinstance(frame, frames.BotStartedSpeakingFrame):
            self._began_s = now_s
        elif isinstance(frame, frames.BotStoppedSpeakingFrame):
            self._began_s = None
            if self._unplayed:
                await self._send_units(self._unplayed.popleft(), whole=True)
        elif not isinstance(frame, frames.SystemFrame) and direction == FrameDirection.DOWNSTREAM:
            with suppress(FaceError):
                await self._show(frame)
            delay_s = 1e-3 * self._unplayed[-1].delay_ms if self._unplayed else 0.0
            last_s = self._line[-1][0] if self._line else 0.0
            self._line.append((max(last_s, now_s + delay_s), frame))
            self._came.set()
            return
        await self.push_frame(frame, direction)

    async def _show(self, frame: frames.Frame) -> None:
        """Send a frame's sound to a connected face, in one stream per turn. Raises FaceError."""
        if isinstance(frame, frames.TTSStoppedFrame) and self._speech is not None:
            speech, self._speech = self._speech, None
            await speech.end()
        elif isinstance(frame, frames.TTSAudioRawFrame) and self._face.is_connected:
            if self._speech is None:
                speech = self._face.stream(frame.sample_rate, "client")
                await speech.__aenter__()
                self._speech = speech
                self._unplayed.append(speech)
            await self._speech.write(mono_pcm(frame.audio, frame.num_channels))

    async def _hand_on(self) -> None:
        """Push each delayed frame at its time, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            if not self._line:
                self._came.clear()
                await self._came.wait()
            elif (wait_s := self._line[0][0] - loop.time()) > 0.0:
                await asyncio.sleep(min(wait_s, _REPORT_S))
            else:
                await self.push_frame(self._line.popleft()[1])

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(_REPORT_S)
            if self._began_s is not None and self._unplayed:
                await self._send_units(self._unplayed[0])

    async def _send_units(self, speech: AsyncSpeech, *, whole: bool = False) -> None:
        now_s, sent_s = asyncio.get_running_loop().time(), speech.n_sent / speech.rate_hz
        played_s = sent_s if whole or self._began_s is None else now_s - self._began_s
        with suppress(FaceError):
            await speech.report_played(min(sent_s, played_s))


def _rest_of(sound: _Unheard) -> frames.TTSAudioRawFrame:
    """Return a waiting frame of sound without the part that was played."""
    width = 2 * sound.frame.num_channels
    n_played = 0 if sound.speech is None else sound.speech.n_played
    n_rest = min(sound.n - n_played, len(sound.frame.audio) // width)
    rest = replace(sound.frame, audio=sound.frame.audio[-n_rest * width :])
    rest.interruptible = sound.frame.interruptible
    return rest
