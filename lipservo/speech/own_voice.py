"""The robot's own speech: what it says is played and shown together."""

import math
from collections import deque
from typing import Final

from lipservo.speech.speech import Speech
from lipsync.arrays import Array
from lipsync.audio.playback_clock import OwnPlaybackClock
from lipsync.audio.playout import Playout
from lipsync.audio.playout_events import PlayoutRequest

#: A loudspeaker whose position stays for so long stands still: a few buffers of the slowest device.
_STALE_S: Final = 0.15
#: Its clock runs on a little until it stands still, too. The mouth opens again once lips and sound
#: are as near as that, which nobody notices.
_MET_S: Final = 0.03
#: Phonemes that wait to be told; nobody is told those of a minute ago.
_MOST_PHONEMES: Final = 256


class OwnVoice:
    """Joins playout, its clock and speech; call `advance` in each tick, before that of speech."""

    def __init__(
        self,
        playout: Playout,
        clock: OwnPlaybackClock,
        speech: Speech,
        rest: Array,
        *,
        quiet_s: float = 0.0,
    ) -> None:
        """clock: of the same speech side. rest: the face (n_components,) of a mouth at rest.

        quiet_s: nothing is said so long after the beginning, as servos are slow at first.
        """
        self._quiet_s = quiet_s
        self.playout = playout
        self._clock = clock
        self._speech = speech
        self._rest = rest
        self._said_s = -1.0
        self._told_position_s, self._moved_s = -math.inf, -math.inf
        self._is_standing = False
        #: (phoneme, start_s, end_s) on the timeline, each when it begins to be heard; one other
        #: thread takes, and may put a deque of its own here before it begins.
        self.phonemes: deque[tuple[str, float, float]] = deque(maxlen=_MOST_PHONEMES)
        clock.lead_s = speech.delay.total_s

    def begin(self) -> None:
        """The timeline begins now: what is committed is played one declared delay later."""
        self.playout.begin(self._clock.lead_s, self._quiet_s)

    def advance(self, now_s: float) -> None:
        """Follow whoever plays, do what was asked for, note which phoneme is heard."""
        self._follow(now_s)
        self._get_up()
        position_s = self._clock.sound_s(now_s) - self._clock.lead_s
        if self.playout.advance(position_s):
            self._speech.cut_off(now_s, self._rest, self.playout.committed_s)
        event = self._speech.event_at(max(0.0, position_s))
        if event is not None and event.start_s > self._said_s:
            self._said_s = event.start_s
            end_s = event.start_s if event.end_s is None else event.end_s
            self.phonemes.append((event.phoneme, event.start_s, end_s))

    def fall_silent(self) -> None:
        """The face is stopped: what was not heard never will be."""
        self.playout.requests.append(PlayoutRequest("interrupt"))
        self.playout.advance(self.playout.position_s)

    def _get_up(self) -> None:
        """A face whose servos rest has them back before anything is said."""
        expression = self._speech.expression
        if expression is not None and expression.is_resting and not self.playout.is_over:
            expression.wake()
            self.playout.be_quiet(self._quiet_s)

    def _follow(self, now_s: float) -> None:
        """A device that stands still closes the mouth; its clock stands still with it."""
        report = self.playout.report()
        if report is None:
            return
        told_s, position_s = report
        self._clock.played(told_s, position_s)
        ahead_s = self._clock.sound_s(now_s) - self._clock.lead_s - position_s - (now_s - told_s)
        if position_s != self._told_position_s:
            self._told_position_s, self._moved_s = position_s, now_s
            self._is_standing = self._is_standing and ahead_s > _MET_S
        elif now_s - self._moved_s > _STALE_S:
            self._is_standing = True
        if self._is_standing:
            self._speech.cut_off(now_s, self._rest)
