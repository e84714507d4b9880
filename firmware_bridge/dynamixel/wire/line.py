"""One half-duplex line: questions to servos and their answers, who may speak when, deadlines."""

from collections.abc import Callable, Iterable, Sequence
from typing import Final, Protocol

from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import (
    BITS_PER_BYTE,
    BROADCAST_ID,
    MAX_ID,
    FrameParser,
    Instruction,
    SpanRead,
    Status,
)
from firmware_bridge.transport import Transport

#: Before anything is known: an FTDI adapter left at its 16 ms latency timer, and a little more.
_UNKNOWN_S: Final = 0.018
#: A computer that does other things wakes up this late once in a hundred times; measured on a
#: loaded two-core machine over a pseudo-terminal.
_LEAST_S: Final = 0.004
_MOST_S: Final = 0.025
#: Once part of a reply is here we are awake, and only adapter and wire can hold back the rest. On
#: the same loaded machine 2 ms lost samples and 4 ms took longer.
_LEAST_REST_S: Final = 0.0035
_RISE, _FALL = 0.5, 0.05
_MARGIN_S: Final = 0.001


class LearntLatency:
    """Follows the largest recent delays: up by half a step at once, down slowly."""

    def __init__(self) -> None:
        self._high_s = _UNKNOWN_S
        #: How long to wait for a reply after its computed time on the wire.
        self.slack_s = min(max(_UNKNOWN_S + _MARGIN_S, _LEAST_S), _MOST_S)

    @property
    def rest_slack_s(self) -> float:
        """The same for the rest of a reply of which part has come."""
        return min(max(self._high_s + _MARGIN_S, _LEAST_REST_S), _MOST_S)

    def learn(self, delay_s: float) -> None:
        """A reply came `delay_s` after its computed time."""
        share = _RISE if delay_s > self._high_s else _FALL
        self._high_s += share * (min(delay_s, _MOST_S) - self._high_s)
        self.slack_s = min(max(self._high_s + _MARGIN_S, _LEAST_S), _MOST_S)


#: How long after we gave up waiting an answer may still arrive. Ours: computers that are busy hold
#: bytes back for up to 190 ms (measured over a pseudo-terminal), adapters for 16.
LATE_S: Final = 0.25
#: In place of an id: whoever there is.
ANYBODY: Final = -1


class PendingAnswers:
    """Whose answer of how many bytes may still come, and until when.

    A status packet says who answers and how many bytes it holds, not which question it answers. So
    a question whose answer would look like a pending one must be asked in another length.
    any: whether there may be something; `expire` makes it exact.
    """

    def __init__(self) -> None:
        self.any = False
        self._until_s: dict[tuple[int, int], float] = {}
        self._n: dict[tuple[int, int], int] = {}
        self._requests: dict[tuple[int, int], bytes] = {}

    @property
    def until_s(self) -> float:
        """When the last of them can no longer come; minus infinity when none is pending."""
        return max(self._until_s.values(), default=float("-inf"))

    def note(self, servo_id: int, size: int, request: bytes, now_s: float) -> None:
        """We waited in vain for `size` bytes in answer to `request`; b"" = to several requests."""
        key = (servo_id, size)
        if self._requests.setdefault(key, request) != request:
            self._requests[key] = b""
        self._until_s[key] = now_s + LATE_S
        self._n[key] = self._n.get(key, 0) + 1
        self.any = True

    def note_arrived(self, servo_id: int, size: int) -> None:
        """An answer of `size` bytes arrived too late for its question."""
        key = (servo_id, size)
        if key in self._n:
            self._n[key] -= 1
            if not self._n[key]:
                self._forget(key)

    def expire(self, now_s: float) -> bool:
        """Forget what can no longer come; whether anything is left."""
        for key in [each for each, until_s in self._until_s.items() if until_s <= now_s]:
            self._forget(key)
        return self.any

    def looks_like(self, servo_id: int, size: int, request: bytes) -> bool:
        """Whether an answer to `request` could be taken for one to some other request.

        For what has the same answer whenever it is asked: pings, and writes of the same bytes.
        """
        return self._requests.get((servo_id, size), request) != request

    def free_size(self, ids: Iterable[int], size: int, step: int = 1) -> int:
        """The least of size, size + step, ... that no pending answer of `ids` has."""
        asked = {*ids, ANYBODY}
        taken = {pending for servo_id, pending in self._until_s if servo_id in asked}
        while size in taken:
            size += step
        return size

    def _forget(self, key: tuple[int, int]) -> None:
        del self._until_s[key], self._requests[key], self._n[key]
        self.any = bool(self._until_s)


#: An int: looking a member up in its enumeration costs as much as comparing three.
_STATUS: Final = int(Instruction.STATUS)


class Take(Protocol):
    """Makes statuses of a stream; None while it wants more, never when `last`."""

    def __call__(self, stream: bytes, *, last: bool) -> Sequence[Status] | None:
        """Take what can be taken."""


#: Return delay of a servo fresh from the factory: 250 x 2 us.
FACTORY_RETURN_DELAY_S: Final = 0.0005
#: What a ping is answered with: model number (2 bytes), firmware version (1). The same bytes lie at
#: 0 and 6 of every control table.
_PONG_SIZE: Final = 3
_IDENTITY_SIZE: Final = 7


class Line:
    """Master of the line. No answer counts that could be the late one to another question.

    Not thread-safe: one owner. Every method raises PortError when the port fails; a servo that
    does not answer is no error but a missing status. Nothing is sent before the computed end of the
    last transaction.
    echoes: the adapter gives back what is sent, which is found out by itself and swallowed.
    extra_wait_s: how long beyond its time an answer is waited for; for commands outside the loop.
    n_bad: damaged packets heard; heard_noise: something came last time, but no valid packet.
    """

    def __init__(
        self,
        transport: Transport,
        return_delay_s: float = FACTORY_RETURN_DELAY_S,
        *,
        extra_wait_s: float = 0.0,
    ) -> None:
        """return_delay_s: the slowest servo's; it lengthens deadlines, not the wire."""
        self.transport = transport
        self.return_delay_s = return_delay_s
        self.byte_s = BITS_PER_BYTE / transport.baud_rate
        self.latency = LearntLatency()
        self.extra_wait_s = extra_wait_s
        self.echoes = False
        self.n_bad = 0
        self.heard_noise = False
        self._clock = transport.clock
        self._parser = FrameParser()
        self._heard = b""  # in answer to the last question
        self._quiet_s = 0.0  # from here on no reply is on the wire any more
        self._sent_s = 0.0  # here our own last byte is
        self._pending = PendingAnswers()

    @property
    def baud_rate(self) -> int:
        """Bits a second on the wire."""
        return self.transport.baud_rate

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None:
        self.transport.baud_rate = baud_rate
        self.byte_s = BITS_PER_BYTE / baud_rate

    def ping(self, servo_id: int, extra_wait_s: float = 0.0) -> Status | None:
        """Model number (2 bytes) and firmware version (1)."""
        request = codec.ping(servo_id)
        if self._has_pending() and self._pending.looks_like(servo_id, _PONG_SIZE, request):
            status = self.read(servo_id, 0, _IDENTITY_SIZE, extra_wait_s)
            if status is None or len(status.data) != _IDENTITY_SIZE:
                return None
            return status._replace(data=status.data[:2] + status.data[-1:])
        return self._ask_one(servo_id, request, _PONG_SIZE, extra_wait_s)

    def ping_each(self, servo_id: int) -> list[Status]:
        """Every answer to one ping: two servos of one id give two, unless they spoil each other."""

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            return self._statuses(stream) if last else None

        if self._has_pending() and self._pending.free_size((servo_id,), _PONG_SIZE) != _PONG_SIZE:
            self._wait_for_pending()
        request = codec.ping(servo_id)
        n_bytes = 2 * (codec.EMPTY_STATUS_SIZE + _PONG_SIZE)
        statuses = self._transact(request, n_bytes, take, extra_wait_s=FACTORY_RETURN_DELAY_S)
        if not statuses:
            self._pending.note(servo_id, _PONG_SIZE, request, self._clock.now())
        return [s for s in statuses if s.servo_id == servo_id and len(s.data) == _PONG_SIZE]

    def ping_all(self) -> list[Status]:
        """Everybody there is, by one broadcast; takes 253 turns of 14 bytes.

        Two servos of one id spoil each other's answer: neither is in the list.
        """

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            return self._statuses(stream) if last else None

        self._wait_for_pending()
        request = codec.ping(BROADCAST_ID)
        n_bytes = (MAX_ID + 1) * (codec.EMPTY_STATUS_SIZE + _PONG_SIZE)
        statuses = self._transact(request, n_bytes, take)
        self._pending.note(ANYBODY, _PONG_SIZE, request, self._clock.now())
        return [status for status in statuses if len(status.data) == _PONG_SIZE]

    def read(
        self, servo_id: int, address: int, size: int, extra_wait_s: float = 0.0
    ) -> Status | None:
        """`size` bytes of one servo. extra_wait_s: waited for longer than an answer should take."""
        if self._pending.any and self._has_pending():
            span = SpanRead((servo_id,), address, size, fast=False)
            wide = span.widened(self._pending.free_size(span.ids, size))
            request = codec.read(servo_id, wide.address, wide.size)
            status = self._ask_one(servo_id, request, wide.size, extra_wait_s, exact=True)
            return None if status is None else span.cut([status], wide.address)[0]
        return self._ask_one(servo_id, codec.read(servo_id, address, size), size, extra_wait_s)

    def write(
        self, servo_id: int, address: int, data: bytes, extra_wait_s: float = 0.0
    ) -> Status | None:
        """Set bytes of one servo, and hear whether it took them; EEPROM may need extra_wait_s."""
        request = codec.write(servo_id, address, data)
        if self._acknowledgement_is_ambiguous(servo_id, request):
            self._tell_one(servo_id, request, extra_wait_s)
            status = self.read(servo_id, address, len(data))
            return status._replace(data=b"") if status is not None and status.data == data else None
        return self._ask_one(servo_id, request, 0, extra_wait_s)

    def reboot(self, servo_id: int) -> Status | None:
        """Restart one servo. None also when its answer could not be told from another."""
        request = codec.reboot(servo_id)
        if self._acknowledgement_is_ambiguous(servo_id, request):
            self._tell_one(servo_id, request, 0.0)
            return None
        return self._ask_one(servo_id, request, 0)

    def tell(self, request: bytes) -> None:
        """Send what nobody answers: a sync write, or anything to everybody but a ping."""
        self._send(request)

    def sync_read(self, span: SpanRead) -> Sequence[Status]:
        """The statuses that came, in the order asked; none is waited for beyond its time."""
        if not (self._pending.any and self._has_pending()):
            return self._ask_span(span)
        if span.fast:
            n, frame = len(span.ids), span.answer_size
            wider = self._pending.free_size((BROADCAST_ID,), frame, step=n)
            wide = span.widened(span.size + (wider - frame) // n)
        else:
            wide = span.widened(self._pending.free_size(span.ids, span.size))
        statuses = self._ask_span(wide)
        return statuses if wide.size == span.size else span.cut(statuses, wide.address)

    def _ask_span(self, span: SpanRead) -> Sequence[Status]:
        n = len(span.ids)

        def take(stream: bytes, *, last: bool) -> Sequence[Status] | None:
            whole = span.take_undisturbed(stream)
            if whole is not None:
                return whole
            statuses = self._salvage(span, stream)
            return statuses if last or len(statuses) == n else None

        statuses = self._transact(span.request, span.reply_size, take, span.is_over, n_turns=n)
        if self._pending.any:
            self._note_late(self._heard, asked_size=span.answer_size)
        if len(statuses) != n:
            self._note_missing(span, statuses)
        return statuses

    def _salvage(self, span: SpanRead, stream: bytes) -> list[Status]:
        """Whatever is whole in a disturbed stream."""
        if span.fast:
            return span.salvage_fast(stream)
        by_id = {s.servo_id: s for s in self._statuses(stream) if len(s.data) == span.size}
        return [by_id[each] for each in span.ids if each in by_id]

    def _note_missing(self, span: SpanRead, statuses: Sequence[Status]) -> None:
        """Who of those asked may answer yet; a common frame comes as a whole."""
        now_s = self._clock.now()
        if span.fast:
            self._pending.note(BROADCAST_ID, span.answer_size, span.request, now_s)
            return
        for servo_id in {*span.ids} - {status.servo_id for status in statuses}:
            self._pending.note(servo_id, span.size, span.request, now_s)

    def _ask_one(
        self,
        servo_id: int,
        request: bytes,
        n_data: int,
        extra_wait_s: float = 0.0,
        *,
        exact: bool = False,
    ) -> Status | None:
        """exact: a refusal does not count either, for it may answer an earlier question."""
        size = codec.EMPTY_STATUS_SIZE + n_data

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            if len(stream) == size:
                status = codec.undisturbed_status(stream)
                if status is not None and status.servo_id == servo_id:
                    return [status]
            found = [
                status
                for status in self._statuses(stream)
                if status.servo_id == servo_id
                and (len(status.data) == n_data or (status.error & 0x7F and not exact))
            ]
            return found[:1] if found or last else None

        found = self._transact(request, size, take, extra_wait_s=extra_wait_s)
        if self._pending.any:
            self._note_late(self._heard, asked_size=n_data)
        if not found:
            self._pending.note(servo_id, n_data, request, self._clock.now())
            return None
        return found[0]

    def _has_pending(self) -> bool:
        """Whether an answer to an earlier question may come yet; takes note of those that have."""
        if not self._pending.any:
            return False
        self._note_late(self.transport.discard_input(), asked_size=None)
        return self._pending.expire(self._clock.now())

    def _note_late(self, stream: bytes, asked_size: int | None) -> None:
        """Cross off what came for earlier questions; not what may answer the one just asked."""
        for status in self._statuses(stream):
            if len(status.data) != asked_size:
                self._pending.note_arrived(status.servo_id, len(status.data))

    def _acknowledgement_is_ambiguous(self, servo_id: int, request: bytes) -> bool:
        """All acknowledgements look alike; one for the same bytes, written again, is as good."""
        if self.extra_wait_s:
            self._wait_for_pending()
        return self._has_pending() and self._pending.looks_like(servo_id, 0, request)

    def _tell_one(self, servo_id: int, request: bytes, extra_wait_s: float) -> None:
        """Send, and leave the line to whatever it is answered with."""
        sent_s = self._send(request)
        answer_s = codec.EMPTY_STATUS_SIZE * self.byte_s + self.return_delay_s + extra_wait_s
        self._quiet_s = sent_s + answer_s
        self._pending.note(servo_id, 0, request, sent_s)

    def _wait_for_pending(self) -> None:
        """Until nothing can come any more; for commands outside the loop."""
        if self._has_pending():
            self._clock.sleep_until(self._pending.until_s)
            self._pending.expire(self._clock.now())

    def _send(self, request: bytes) -> float:
        """When the last byte will be on the wire; our own bytes queue up and need no waiting."""
        now_s = self._clock.now()
        if now_s < self._quiet_s:
            self._clock.sleep_until(self._quiet_s)
            now_s = self._clock.now()
        self.transport.write(request)
        begin_s = now_s if now_s > self._sent_s else self._sent_s
        self._sent_s = begin_s + len(request) * self.byte_s
        return self._sent_s

    def _transact(
        self,
        request: bytes,
        reply_size: int,
        take: Take,
        is_over: Callable[[bytes], bool] = lambda _: False,
        *,
        n_turns: int = 1,
        extra_wait_s: float = 0.0,
    ) -> Sequence[Status]:
        """Send, then read until `take` is content or the time of the reply is over."""
        transport, clock = self.transport, self._clock
        if self.extra_wait_s > extra_wait_s:
            extra_wait_s = self.extra_wait_s
        transport.discard_input()
        due_s = self._send(request) + reply_size * self.byte_s
        wire_end_s = due_s + n_turns * self.return_delay_s
        deadline_s = wire_end_s + self.latency.slack_s + extra_wait_s
        clock.sleep_until(due_s)
        heard = transport.read(deadline_s)
        while True:
            if len(heard) == reply_size and not self.echoes:  # what nearly every answer is
                stream, ended = heard, False
            else:
                stream = self._without_echo(heard, request)
                ended = is_over(stream)
            if ended or len(stream) >= reply_size:
                statuses = take(stream, last=ended)
                if statuses is not None:
                    self._heard = stream
                    self._quiet_s = clock.now()
                    if not extra_wait_s:
                        self.latency.learn(self._quiet_s - due_s)
                    self.heard_noise = False
                    return statuses
            if stream and not extra_wait_s:
                rest_s = max(wire_end_s, clock.now()) + self.latency.rest_slack_s
                deadline_s = min(deadline_s, rest_s)
            more = transport.read(deadline_s)
            if not more:
                self._heard = stream
                self._quiet_s = max(wire_end_s, clock.now())
                statuses = take(stream, last=True) or []
                self.heard_noise = bool(stream) and not statuses
                return statuses
            heard += more

    def _without_echo(self, heard: bytes, request: bytes) -> bytes:
        """What came after our own bytes, if the adapter gives those back.

        What came before them cannot answer this request, since the line carries one at a time.
        """
        at = heard.find(request)
        if at < 0:
            return heard
        self.echoes = True
        return heard[at + len(request) :]

    def _statuses(self, stream: bytes) -> list[Status]:
        """Every whole status packet in a stream, whatever else is in it."""
        self._parser.reset()
        n_bad = self._parser.n_bad
        statuses = [
            Status(frame.packet_id, frame.parameters[0], frame.parameters[1:])
            for frame in self._parser.feed(stream)
            if frame.instruction == _STATUS and frame.parameters
        ]
        self.n_bad += self._parser.n_bad - n_bad
        return statuses
