"""The robot's own speech: what it says is played and shown together."""

from collections import deque
from typing import Final

from lipservo.street.speech import Speech
from lipsync.arrays import Array
from lipsync.audio.playback_clock import OwnPlaybackClock
from lipsync.audio.playout import Playout
from lipsync.audio.playout_events import PlayoutRequest
from lipsync.phonemes import PhonemeEvent

#: A loudspeaker that reports nothing for so long stands still: a few buffers of the slowest device.
_STALE_S: Final = 0.15
#: Phonemes that wait to be told; nobody is told those of a minute ago.
_MOST_PHONEMES: Final = 256


class OwnVoice:
    """Joins playout, its clock and speech; call `advance` in each tick, before that of speech."""

    def __init__(
        self, playout: Playout, clock: OwnPlaybackClock, speech: Speech, rest: Array
    ) -> None:
        """clock: of the same speech side. rest: the face (n_components,) of a mouth at rest."""
        self.playout = playout
        self._clock = clock
        self._speech = speech
        self._rest = rest
        self._said_s = -1.0
        self._is_standing = False
        #: Phonemes on the timeline, each when it begins to be heard; one other thread takes.
        self.phonemes: deque[PhonemeEvent] = deque(maxlen=_MOST_PHONEMES)
        clock.lead_s = speech.delay.total_s

    def begin(self) -> None:
        """The timeline begins now: what is committed is played one declared delay later."""
        self.playout.begin(self._clock.lead_s)

    def advance(self, now_s: float) -> None:
        """Follow whoever plays, do what was asked for, note which phoneme is heard."""
        self._follow(now_s)
        position_s = self._clock.sound_s(now_s) - self._clock.lead_s
        if self.playout.advance(position_s):
            self._speech.cut_off(now_s, self._rest, self.playout.committed_s)
        event = self._speech.event_at(max(0.0, position_s))
        if event is not None and event.start_s > self._said_s:
            self._said_s = event.start_s
            self.phonemes.append(event)

    def fall_silent(self) -> None:
        """The face is stopped: what was not heard never will be."""
        self.playout.requests.append(PlayoutRequest("interrupt"))
        self.playout.advance(self.playout.position_s)

    def _follow(self, now_s: float) -> None:
        report = self.playout.report()
        if report is None:
            return
        told_s, position_s = report
        age_s = now_s - told_s
        if age_s <= _STALE_S:
            self._is_standing = False
            self._clock.played(told_s, position_s)
            return
        self._clock.played(now_s, position_s + _STALE_S)
        if not self._is_standing:
            self._is_standing = True
            self._speech.cut_off(now_s, self._rest)
