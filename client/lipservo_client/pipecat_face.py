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
from lipservo_client.protocol import FaceError, Played, error_of, mono_pcm

#: Texts that are kept until their stream begins; of more, the oldest are dropped.
_MOST_UNSENT_TEXTS: Final = 64
#: The face is asked for its position so often while frames wait for sound to be played.
_POLL_S: Final = 0.05
#: Longest time for which an interruption holds the pipeline up.
_INTERRUPTING_S: Final = 1.0
#: Turns of the event loop after an interruption: a frame passes a processor in two or three, so
#: text that was heard reaches an aggregator up to twenty processors behind, before queues are
#: cleared.
_SETTLING_PASSES: Final = 64
#: Between two reports of what a transport has played.
_REPORT_S: Final = 0.1
#: Key in the metadata of a TTS context's first sound: the time in ns from which Pipecat times its
#: words.
_TIMED_FROM: Final = "lipservo_timed_from_ns"


class _FaceProcessor(FrameProcessor):
    """A frame processor that connects to a face at the start, and again after every loss."""

    def __init__(self, url: str, token: str | None) -> None:
        super().__init__()
        self._face = AsyncFace(url, token)
        self._speech: AsyncSpeech | None = None
        self._tasks: list[asyncio.Task[None]] = []

    async def cleanup(self) -> None:
        """Cancel the processor's tasks and disconnect from the face."""
        await super().cleanup()
        for task in self._tasks:
            await self.cancel_task(task)
        await self._face.__aexit__()

    async def _connect_face(self, *working: Coroutine[Any, Any, None]) -> None:
        """Connect to the face, and run the `working` coroutines until the pipeline ends."""
        self._tasks = [self.create_task(each) for each in working]
        try:
            await self._face.__aenter__()
        except FaceError as error:
            await self._push_face_error(error)
            self._face.keep_trying()

    async def _end_speech(self) -> None:
        """Send the end of the open stream, if any, and forget the stream."""
        speech, self._speech = self._speech, None
        if speech is not None:
            with suppress(FaceError):
                await speech.end()

    async def _push_face_error(self, error: Exception) -> None:
        """Push an error of the face upstream, as a Pipecat error frame."""
        await self.push_error(f"the face: {error}", exception=error)

    async def _interrupt_face(self) -> Played | None:
        """Interrupt the face; return how much was played.

        None: nothing was unfinished, or an error came, or no answer within a second.
        """
        try:
            async with asyncio.timeout(_INTERRUPTING_S):
                return await self._face.interrupt()
        except (FaceError, TimeoutError) as error:
            await self._push_face_error(error)
            return None


@dataclass(slots=True)
class _Waiting:
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
        """Whether the sound before the frame was played; for a frame of sound, its own.

        A word with a time is heard once all of its text counts as heard. True without speech.
        """
        speech = self.speech
        if speech is None or speech.was_heard:
            return True
        if self.is_timed:
            return self._heard_text(speech) == str(self.frame.text)
        return speech.n_played >= self.n

    @property
    def may_go_on(self) -> bool:
        """Whether the frame's turn has come: its sound was played, or never will be.

        A frame that is no sound also waits until the stream is over, once its end was sent.
        """
        if self.speech is None or self.speech.is_over:
            return True
        return self.is_heard and (self.is_sound or not self.speech.is_complete)

    def as_heard(self) -> frames.Frame | None:
        """Return the frame to push on; of text only the words that were heard.

        None for sound, for text of which nothing was heard, and for other frames whose turn has not
        come.
        """
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
        return self.words.part(self.piece, speech.n_played, is_complete=speech.is_complete)


class PipecatFace(_FaceProcessor):
    """A processor behind the TTS service that plays its sound on a face instead of a transport.

    Frames behind sound go on when the sound was played, so that the context contains what a person
    heard. While no face answers, an error is pushed and the sound goes on to the transport, until
    the face is back and the transport has played it. last_played: how much of the speech was played
    at the last interruption; None: no speech was cut off, or it is not known.
    """

    def __init__(self, url: str = "ws://127.0.0.1:8765", token: str | None = None) -> None:
        super().__init__(url, token)
        #: The frames that wait until sound before them was played.
        self._line: list[_Waiting] = []
        self._releasing = asyncio.Lock()
        self._spoken_words = SpokenWords(1)
        #: The sample at which the last sentence ends: the sound of the next one begins there.
        self._n_spoken = 0
        #: By TTS context: the sample and the time (ns) from which its words are timed. As Pipecat
        #: counts, that is when its sound came, or the last word before it if that is later.
        self._contexts: dict[str | None, tuple[int, int]] = {}
        self._last_word_ns = 0
        self._open_contexts: set[str | None] = set()
        self._has_loudspeaker = True
        #: Texts whose stream has not begun; and whether the service announces whole sentences, so
        #: that the same words come again when they are spoken.
        self._unsent_texts: list[str] = []
        self._announces_sentences = False
        self._is_speaking = False
        self._is_complete = False
        #: Whether the turn was cut off at the face, so that the rest of its sound is dropped.
        self._is_cut_off = False
        #: Event loop time until which the transport plays sound that went on to it.
        self._transport_until_s = 0.0
        self.last_played: Played | None = None

    async def queue_frame(
        self,
        frame: frames.Frame,
        direction: FrameDirection = FrameDirection.DOWNSTREAM,
        callback: FrameCallback | None = None,
    ) -> None:
        """Queue a frame; note when a context's first sound came, from which its words are timed.

        Noted here, since a frame may then wait for long, until the face takes more sound.
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
            await self._connect_face(self._follow_events(), self._poll_positions())
        elif isinstance(frame, (frames.InterruptionFrame, frames.CancelFrame)):
            await self._interrupt_speech(everything=isinstance(frame, frames.CancelFrame))
        elif not isinstance(frame, frames.SystemFrame) and direction == FrameDirection.DOWNSTREAM:
            await self._process_in_order(frame)
            return
        await self.push_frame(frame, direction)

    async def _process_in_order(self, frame: frames.Frame) -> None:
        """Send a frame's sound or text to the face, and let the frame wait for the sound before it.

        Text of a turn that was cut off at the face is dropped.
        """
        if isinstance(frame, frames.TTSAudioRawFrame):
            await self._send_sound(frame)
            return
        if self._is_cut_off and isinstance(frame, frames.TextFrame):
            return
        if isinstance(frame, frames.AggregatedTextFrame):
            await self._send_text(frame)
        self._queue_behind_sound(frame)
        if isinstance(frame, frames.TTSStoppedFrame):
            self._is_complete, self._is_cut_off = True, False
            if self._speech is not None:
                # Makes the face play the last, incomplete block; the stream's end is sent only when
                # all sound was played.
                with suppress(FaceError):
                    await self._speech.mark("said")
        # An interruption cancels this task, but frames whose sound was played are still pushed.
        await asyncio.shield(self._push_heard_frames())

    async def _send_sound(self, frame: frames.TTSAudioRawFrame) -> None:
        """Send a frame of sound to the face, waiting while 30 s are unplayed; or push it.

        The frame is pushed, for the transport to play, while no face with a loudspeaker is
        connected, and until the transport has played what was pushed. It is dropped if the turn was
        cut off at the face.
        """
        now_s = asyncio.get_running_loop().time()
        seconds = len(frame.audio) / (2 * frame.num_channels * frame.sample_rate)
        self._is_complete = False
        if self._is_cut_off:
            return
        face_plays = self._face.is_connected and self._has_loudspeaker
        # No face can play it, or the transport still plays earlier sound: the transport gets it.
        if self._speech is None and (now_s < self._transport_until_s or not face_plays):
            self._transport_until_s = max(now_s, self._transport_until_s) + seconds
            await self.push_frame(frame)
            return
        pcm = mono_pcm(frame.audio, frame.num_channels)
        try:
            speech = await self._open_stream(frame.sample_rate)
            words = self._spoken_words
            if _TIMED_FROM in frame.metadata:
                self._contexts[frame.context_id] = (words.n_samples, frame.metadata[_TIMED_FROM])
            words.n_samples += len(pcm) // 2
            self._line.append(_Waiting(speech, words.n_samples, frame, words))
            texts, self._unsent_texts = self._unsent_texts, []
            for text in texts:
                await speech.tell(text)
            self._is_cut_off = not await speech.write(pcm)
        except FaceError as error:
            await self._push_face_error(error)
            if error.code == "no_loudspeaker":
                self._speech, self._has_loudspeaker = None, False
                return await self._send_sound(frame)
            self._is_cut_off = True
        if self._is_cut_off:
            await asyncio.shield(self._push_heard_frames())

    async def _open_stream(self, rate_hz: int) -> AsyncSpeech:
        """Return this turn's open stream; a new one for a new turn or rate. Raises FaceError."""
        speech = self._speech
        if speech is not None and speech.rate_hz != rate_hz:
            await speech.end()
            speech = None
        if speech is None:
            speech = self._face.stream(rate_hz)
            self._speech, self._n_spoken = speech, 0
            self._spoken_words = SpokenWords(rate_hz)
            self._contexts.clear()
            await speech.__aenter__()
        return speech

    async def _send_text(self, frame: frames.AggregatedTextFrame) -> None:
        """Send a frame's text to the face: words with times, or sentences before their sound.

        Before the turn's stream is open, texts are kept for it. Words without times are not sent if
        the service has announced their sentence.
        """
        is_spoken = isinstance(frame, frames.TTSTextFrame)
        n = self._sample_of(frame)
        text = frame.text.strip()
        if not text or not (is_spoken or frame.will_be_spoken):
            return
        self._announces_sentences = self._announces_sentences or not is_spoken
        if n is None and is_spoken and self._announces_sentences:
            return
        if self._speech is None:
            self._unsent_texts = [*self._unsent_texts, text][-_MOST_UNSENT_TEXTS:]
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

    def _queue_behind_sound(self, frame: frames.Frame) -> None:
        """Queue a frame until the sound before it was played.

        A word with a time is queued at its sample of the stream, others behind all sound so far.
        """
        speech = self._speech or (self._line[-1].speech if self._line else None)
        n = self._sample_of(frame)
        words, piece = self._spoken_words, None
        if n is not None:
            # Before the frames of this stream that wait for later samples.
            index = len(self._line)
            while index and self._line[index - 1].speech is speech and self._line[index - 1].n > n:
                index -= 1
            piece = words.add(frame.text, n)
            self._line.insert(index, _Waiting(speech, n, frame, words, piece, is_timed=True))
            return
        n = words.n_samples if speech is self._speech else self._line[-1].n
        # No frame in the line may wait for a later sample than one behind it.
        for each in self._line:
            each.n = min(each.n, n) if each.speech is speech else each.n
        if isinstance(frame, frames.TTSTextFrame) and self._speech is not None:
            piece = words.add(frame.text, self._n_spoken, n)
            self._n_spoken = n
        self._line.append(_Waiting(speech, n, frame, words, piece))

    async def _push_heard_frames(self) -> None:
        """Push the waiting frames whose sound was played; drop text that will never be spoken."""
        async with self._releasing:
            speech = self._speech
            if self._is_complete and all(each.is_heard for each in self._line if each.is_sound):
                await self._end_speech()
            while self._line and self._line[0].may_go_on:
                if (heard := self._line.pop(0).as_heard()) is not None:
                    await self.push_frame(heard)
            if speech is not None and speech.is_over:
                self._is_cut_off = not (speech.was_heard or self._is_complete)
                await self._end_speech()
            if self._speech is None and not self._line:
                await self._broadcast_speaking(False)

    async def _broadcast_speaking(self, is_speaking: bool) -> None:
        """Broadcast that the bot starts or stops speaking, unless that was broadcast last."""
        if is_speaking != self._is_speaking:
            self._is_speaking = is_speaking
            kind = frames.BotStartedSpeakingFrame if is_speaking else frames.BotStoppedSpeakingFrame
            await self.broadcast_frame(kind)

    async def _interrupt_speech(self, *, everything: bool) -> None:
        """Interrupt the face, push the frames already played, and send uninterruptible ones again.

        Text of which a part was heard is pushed with that part. everything: uninterruptible frames
        are dropped too.
        """
        async with self._releasing:
            # The face is not interrupted if all of its unplayed sound must not be.
            sound = [each for each in self._line if each.is_sound and not each.is_heard]
            may_cut = any(each.frame.interruptible or everything for each in sound)
            is_spoken = may_cut or (not sound and self._speech is not None)
            is_cut = self._face.is_connected and is_spoken
            self.last_played = await self._interrupt_face() if is_cut else None
            line, self._line = self._line, []
            resent: list[_Waiting] = []
            for each in line:
                passes_on = each.is_heard or isinstance(each.frame, frames.TextFrame)
                if not (each.is_heard or each.frame.interruptible or everything):
                    (resent if is_cut else self._line).append(each)
                elif passes_on and (heard := each.as_heard()) is not None:
                    await self.push_frame(heard)
            self._is_cut_off, self._transport_until_s = False, 0.0
            self._unsent_texts.clear()
            self._speech = None if is_cut else self._speech
        for _ in range(_SETTLING_PASSES):
            await asyncio.sleep(0.0)
        for each in resent:
            await self._process_in_order(_unplayed_rest(each) if each.is_sound else each.frame)
        await self._push_heard_frames()

    async def _follow_events(self) -> None:
        """Push frames whose sound was played; broadcast the bot's speaking, and report a loss."""
        async for event in self._face.events():
            if event["type"] == "disconnected":
                self._has_loudspeaker = True  # the next may have one
                await self._push_face_error(error_of(event))
            if self._speech is not None and event.get("stream") == self._speech.stream:
                if event["type"] == "started":
                    await self._broadcast_speaking(True)
                elif event["type"] == "position" and self._is_speaking:
                    await self.broadcast_frame(frames.BotSpeakingFrame)
            await self._push_heard_frames()

    async def _poll_positions(self) -> None:
        while True:
            await asyncio.sleep(_POLL_S)
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
        self._has_turn_begun = False
        #: (event loop time at which it is pushed, frame); and the streams of the turns
        #: not yet played, None where no face took one.
        self._line: deque[tuple[float, frames.Frame]] = deque()
        self._unplayed: deque[AsyncSpeech | None] = deque()
        self._frame_came = asyncio.Event()
        #: Event loop time since which the transport plays the bot's speech; None: it does not.
        self._began_s: float | None = None

    async def process_frame(self, frame: frames.Frame, direction: FrameDirection) -> None:
        """Send sound to the face, and push frames later, by the face's delay.

        System frames, and frames that go upstream, are pushed at once.
        """
        await super().process_frame(frame, direction)
        now_s = asyncio.get_running_loop().time()
        if isinstance(frame, frames.StartFrame):
            await self._connect_face(self._push_delayed_frames(), self._report_positions())
        elif isinstance(frame, (frames.InterruptionFrame, frames.CancelFrame)):
            self._line = deque(each for each in self._line if not each[1].interruptible)
            self._speech, self._began_s, self._has_turn_begun = None, None, False
            self._unplayed.clear()
            if self._face.is_connected:
                await self._interrupt_face()
        elif isinstance(frame, frames.BotStartedSpeakingFrame):
            self._began_s = now_s
        elif isinstance(frame, frames.BotStoppedSpeakingFrame):
            self._began_s = None
            if self._unplayed:
                await self._report_played(self._unplayed.popleft(), whole=True)
        elif not isinstance(frame, frames.SystemFrame) and direction == FrameDirection.DOWNSTREAM:
            with suppress(FaceError):
                await self._send_to_face(frame)
            delay_s = 1e-3 * self._speech.delay_ms if self._speech is not None else 0.0
            last_s = self._line[-1][0] if self._line else 0.0
            self._line.append((max(last_s, now_s + delay_s), frame))
            self._frame_came.set()
            return
        await self.push_frame(frame, direction)

    async def _send_to_face(self, frame: frames.Frame) -> None:
        """Send a frame's sound to a connected face, in one stream per turn. Raises FaceError."""
        if isinstance(frame, frames.TTSStoppedFrame):
            self._has_turn_begun = False
            await self._end_speech()
        elif isinstance(frame, frames.TTSAudioRawFrame):
            if not self._has_turn_begun:
                # Where no face takes the turn now, none shows it: a stream that began later would
                # not fit what the transport reports of the turn.
                with suppress(FaceError):
                    speech = self._face.stream(frame.sample_rate, "client")
                    await speech.__aenter__()
                    self._speech = speech
                self._unplayed.append(self._speech)
                self._has_turn_begun = True
            if self._speech is not None:
                await self._speech.write(mono_pcm(frame.audio, frame.num_channels))

    async def _push_delayed_frames(self) -> None:
        """Push each delayed frame at its time, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            if not self._line:
                self._frame_came.clear()
                await self._frame_came.wait()
            elif (wait_s := self._line[0][0] - loop.time()) > 0.0:
                await asyncio.sleep(min(wait_s, _REPORT_S))
            else:
                await self.push_frame(self._line.popleft()[1])

    async def _report_positions(self) -> None:
        while True:
            await asyncio.sleep(_REPORT_S)
            if self._began_s is not None and self._unplayed:
                await self._report_played(self._unplayed[0])

    async def _report_played(self, speech: AsyncSpeech | None, *, whole: bool = False) -> None:
        """Report to the face how many s of a stream the transport has played; all if `whole`."""
        if speech is None:
            return
        now_s, sent_s = asyncio.get_running_loop().time(), speech.n_sent / speech.rate_hz
        played_s = sent_s if whole or self._began_s is None else now_s - self._began_s
        with suppress(FaceError):
            await speech.report_played(min(sent_s, played_s))


def _unplayed_rest(sound: _Waiting) -> frames.TTSAudioRawFrame:
    """Return a waiting frame of sound without the part that was played.

    The frame ends at sample `sound.n` of its stream.
    """
    frame_bytes = 2 * sound.frame.num_channels
    n_played = 0 if sound.speech is None else sound.speech.n_played
    n_heard = max(len(sound.frame.audio) // frame_bytes - (sound.n - n_played), 0)
    rest = replace(sound.frame, audio=sound.frame.audio[n_heard * frame_bytes :])
    rest.interruptible = sound.frame.interruptible
    return rest
