"""One request to many servos, sent as fast or plain read, whichever gets the most answers."""

from collections.abc import Sequence
from typing import Final

from firmware_bridge.dynamixel.wire.codec import EMPTY_STATUS_SIZE, SpanRead, Status
from firmware_bridge.dynamixel.wire.line import Line

#: A servo silent this often in a row is read last from then on: it may cut off those behind it.
_SUSPECT_AFTER: Final = 2
#: A servo silent this often in a row is left out, but for every 200th request.
_ABSENT_AFTER: Final = 5
_RETRY_EVERY: Final = 200
#: A fast read loses all data behind a lost part. After two bad ones among a hundred, plain reads
#: are used, with a frame for each servo. After 2,000 requests fast reads are tried once more; after
#: each relapse plain reads last twice as long, up to ten minutes at 100 Hz. Some servos do not know
#: fast reads: until one has come whole, servos that it lacks are read in the plain way as well.
_BAD_FAST_READS: Final = 2
_FAST_WINDOW: Final = 100
_SLOW_FOR: Final = 2_000
_SLOW_AT_MOST: Final = 64_000
#: Time on the wire that asking again for lost parts may take within a cycle: six of ten bytes each
#: at 1 Mbaud, none at 57,600 baud. With the wait for the first answers it stays below 6 ms.
_AGAIN_S: Final = 0.0015


class SpanGroup:
    """A repeated read of the same registers of servos `ids`; a fast read while that works.

    Servos that were silent in two successive reads are read last, after five only now and then.
    leaves_out: whether any servo is read only now and then.
    """

    def __init__(self, ids: Sequence[int], address: int, size: int) -> None:
        self._ids = tuple(ids)
        self._address = address
        self._size = size
        self.reset()

    def reset(self) -> None:
        """Start anew: no servo counts as silent, and fast reads are tried.

        `_proven`: a fast read came whole since the last switch to plain reads; `_ever_proven`:
        since this reset. `_silent`: by id, how often in a row a servo did not answer.
        """
        self._proven = False
        self._ever_proven = False
        self._n_refused = 0
        self._retried: set[int] = set()
        self._silent = dict.fromkeys(self._ids, 0)
        self.answers: Sequence[Status] = []
        self.request = SpanRead(self._ids, self._address, self._size, fast=True)
        self._n_requests = self._n_bad = self._slow_until = 0
        self._slow_for = _SLOW_FOR
        self._prepare()

    @property
    def fast(self) -> bool:
        """Whether the next request is a fast read."""
        return self._n_requests >= self._slow_until

    @property
    def fast_unsupported(self) -> bool:
        """Whether fast reads have never been answered, although plain ones are."""
        return self._n_refused >= _BAD_FAST_READS and not self._ever_proven

    def ask(self, line: Line) -> Sequence[Status]:
        """Send the request; return the whole answers that came, in no particular order.

        Missing answers may be requested once more. Which servos were silent decides on the order of
        ids in the next request, and on whether that is a fast read.
        """
        if self._n_requests == self._slow_until or self._n_requests % _RETRY_EVERY == 0:
            self._prepare(retry=self._n_requests % _RETRY_EVERY == 0)
        span = self.request = self._span
        statuses = line.sync_read(span)
        self._n_requests += 1
        if len(statuses) == len(span.ids):
            if span.fast and not self._proven:
                self._proven = self._ever_proven = True
            if len(span.ids) != len(self._ids) or self._doubted:
                self._judge(span, statuses, [])
        else:
            again = self._ask_again(line, statuses)
            self._judge(span, statuses, again)
            statuses = [*statuses, *again]
        self.answers = statuses
        return statuses

    def _ask_again(self, line: Line, statuses: Sequence[Status]) -> Sequence[Status]:
        """Request missing answers again, one frame a servo, as far as time allows; return these.

        statuses: the answers that came. No retry when no servo answered, since then single packets
        are not the problem; and none for servos that were silent several times. The first missing
        servo is read last: it may cut off the others. While no fast read has come whole yet, all
        that are missing are read again, however long that takes.
        """
        on_trial = self.request.fast and not self._proven
        if not statuses and not on_trial:
            return []
        answered = {status.servo_id for status in statuses}
        missing = [
            each
            for each in self.request.ids
            if each not in answered and self._silent[each] < _SUSPECT_AFTER
        ]
        n_fit = int(_AGAIN_S / line.byte_s / (self._size + EMPTY_STATUS_SIZE + 1))
        ids = missing[1:] + missing[:1]
        if not on_trial:
            ids = ids[:n_fit]
        if not ids:
            return []
        self._retried = {*ids}
        again = line.sync_read(SpanRead(ids, self._address, self._size, fast=False))
        self._n_refused += bool(on_trial and not statuses and again)
        return again

    def trust(self, servo_id: int) -> None:
        """Include a servo again that was left out, since it has answered another read."""
        if self._silent[servo_id] >= _ABSENT_AFTER:
            self._silent[servo_id] = 0
            self._prepare()

    def _judge(self, span: SpanRead, statuses: Sequence[Status], again: Sequence[Status]) -> None:
        """Count which servos were silent, to put them last in the next request or leave them out.

        statuses: the answers to `span`; again: those to the retry for what was missing. Bad fast
        reads are counted as well.
        """
        # cut_off: not in the first answers, in the order of the request; missing: nor in the retry
        at_once = {status.servo_id for status in statuses}
        late = {status.servo_id for status in again}
        answered = at_once | late
        cut_off = [each for each in span.ids if each not in at_once]
        missing = [each for each in cut_off if each not in late]
        self._doubted = bool(missing)
        changed = False
        for servo_id in answered:
            changed |= self._silent[servo_id] >= _SUSPECT_AFTER
            self._silent[servo_id] = 0
        # In a fast read, servos behind the first silent one may only have been cut off. If no servo
        # answered, line or computer stalled. In both cases only the first counts as silent.
        first_only = span.fast or not answered
        silent_now = [each for each in cut_off[:1] if each in missing] if first_only else missing
        most = _ABSENT_AFTER if answered else _SUSPECT_AFTER
        for servo_id in silent_now:
            if self._silent[servo_id] < most:
                self._silent[servo_id] += 1
            changed |= self._silent[servo_id] >= _SUSPECT_AFTER
        if span.fast and cut_off and answered:
            changed = True
            if not (late and self._retried - late <= {cut_off[0]} and cut_off[0] in missing):
                self._count_bad_fast(cut_off)  # else one silent servo explains what is missing
        if changed:
            self._prepare()

    def _count_bad_fast(self, missing: list[int]) -> None:
        """Count a fast read that lacks ids `missing`; two in 100 requests switch to plain reads.

        Plain reads last for 2,000 requests, each further time twice as many. Not counted where
        every missing servo is known to be silent: fast reads are not at fault.
        """
        if all(self._silent[each] >= _SUSPECT_AFTER for each in missing):
            return
        if self._n_requests % _FAST_WINDOW == 0:
            self._n_bad = 0
        self._n_bad += 1
        if self._n_bad >= _BAD_FAST_READS:
            self._n_bad = 0
            self._proven = False
            self._slow_until = self._n_requests + self._slow_for
            self._slow_for = min(2 * self._slow_for, _SLOW_AT_MOST)

    def _prepare(self, *, retry: bool = False) -> None:
        """Prepare the next request: silent servos last, long silent ones only if `retry`."""
        trusted = [each for each in self._ids if self._silent[each] < _SUSPECT_AFTER]
        doubtful = [
            each
            for each in self._ids
            if self._silent[each] >= _SUSPECT_AFTER
            and (retry or self._silent[each] < _ABSENT_AFTER)
        ]
        self.leaves_out = any(n >= _ABSENT_AFTER for n in self._silent.values())
        ids = trusted + doubtful or list(self._ids)
        self._doubted = len(ids) != len(self._ids) or bool(doubtful)
        self._span = SpanRead(ids, self._address, self._size, fast=self.fast)
