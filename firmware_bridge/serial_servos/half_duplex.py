"""A half-duplex serial line to servos: transactions, learnt waiting times, late answers, echoes."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, Final, Protocol, TypeVar

from firmware_bridge.transport import Transport

#: A start bit, eight data bits, a stop bit.
BITS_PER_BYTE: Final = 10
#: First guess of the delay: an FTDI adapter left at its 16 ms latency timer, and a little more.
_UNKNOWN_S: Final = 0.018
#: Bounds of the wait. A busy computer wakes up 4 ms late once in a hundred times; measured on a
#: loaded two-core machine over a pseudo-terminal.
_LEAST_S: Final = 0.004
_MOST_S: Final = 0.025
#: Once part of a reply has come the process is awake, and only adapter and wire can hold back the
#: rest. On the same loaded machine 2 ms lost samples and 4 ms took longer.
_LEAST_REST_S: Final = 0.0035
#: Share of the difference by which the learnt delay follows a slower, and a quicker, reply.
_RISE, _FALL = 0.5, 0.05
_MARGIN_S: Final = 0.001


class LearntLatency:
    """The time to wait for late replies, learnt from their delays: quick to rise, slow to fall."""

    def __init__(self) -> None:
        self._high_s = _UNKNOWN_S
        #: How long to wait for a reply after its computed time on the wire.
        self.slack_s = min(max(_UNKNOWN_S + _MARGIN_S, _LEAST_S), _MOST_S)

    @property
    def rest_slack_s(self) -> float:
        """How many seconds to wait for the rest of a reply of which a part has come."""
        return min(max(self._high_s + _MARGIN_S, _LEAST_REST_S), _MOST_S)

    def learn(self, delay_s: float) -> None:
        """Adapt the waiting times to a reply that came `delay_s` after its computed time."""
        share = _RISE if delay_s > self._high_s else _FALL
        self._high_s += share * (min(delay_s, _MOST_S) - self._high_s)
        self.slack_s = min(max(self._high_s + _MARGIN_S, _LEAST_S), _MOST_S)


#: How long after its deadline an answer may still arrive. Our choice: computers that are busy hold
#: bytes back for up to 190 ms (measured over a pseudo-terminal), adapters for 16.
LATE_S: Final = 0.25
#: In place of a servo's id: the answer may come from any servo.
ANYBODY: Final = -1


class PendingAnswers:
    """Answers that may still come late: from which servo, of how many bytes, and until when.

    A status packet contains its servo and its length, but not the request that it answers. So a
    request whose answer would look like a pending one must ask for another number of bytes.
    any: whether answers may be pending; `expire` makes it exact.
    """

    def __init__(self) -> None:
        self.any = False
        self._until_s: dict[tuple[int, int], float] = {}
        self._n: dict[tuple[int, int], int] = {}
        self._requests: dict[tuple[int, int], bytes] = {}

    @property
    def until_s(self) -> float:
        """When the last pending answer can no longer come; minus infinity: none is pending."""
        return max(self._until_s.values(), default=float("-inf"))

    def note(self, servo_id: int, size: int, request: bytes, now_s: float) -> None:
        """Note that a servo's answer with `size` data bytes to `request` did not come in time.

        The answer counts as pending until `LATE_S` after `now_s`.
        """
        key = (servo_id, size)
        # Answers of this size to two different requests cannot be told apart: b"" in their place.
        if self._requests.setdefault(key, request) != request:
            self._requests[key] = b""
        self._until_s[key] = now_s + LATE_S
        self._n[key] = self._n.get(key, 0) + 1
        self.any = True

    def note_arrived(self, servo_id: int, size: int) -> None:
        """Note that a servo's answer with `size` data bytes has arrived late: one fewer pending.

        An answer that was not pending is ignored.
        """
        key = (servo_id, size)
        if key in self._n:
            self._n[key] -= 1
            if not self._n[key]:
                self._forget(key)

    def expire(self, now_s: float) -> bool:
        """Forget answers that can no longer come; return whether any is still pending."""
        for key in [each for each, until_s in self._until_s.items() if until_s <= now_s]:
            self._forget(key)
        return self.any

    def looks_like(self, servo_id: int, size: int, request: bytes) -> bool:
        """Return whether a pending answer could be mistaken for the servo's answer to `request`.

        True if that pending answer has as many data bytes (`size`) and belongs to another request.
        """
        return self._requests.get((servo_id, size), request) != request

    def free_size(self, ids: Iterable[int], size: int, step: int = 1) -> int:
        """Return the least of size, size + step, ... that no pending answer of `ids` has as size.

        A request for so many data bytes gets an answer that no late one can be mistaken for.
        """
        allowed_ids = {*ids, ANYBODY}
        taken = {pending for servo_id, pending in self._until_s if servo_id in allowed_ids}
        while size in taken:
            size += step
        return size

    def _forget(self, key: tuple[int, int]) -> None:
        del self._until_s[key], self._requests[key], self._n[key]
        self.any = bool(self._until_s)


_Answer = TypeVar("_Answer")
_Taken_co = TypeVar("_Taken_co", covariant=True)


class Take(Protocol[_Taken_co]):
    """A function that parses the bytes of a reply received so far."""

    def __call__(self, stream: bytes, *, last: bool) -> _Taken_co | None:
        """Return the answer in `stream`; None: there is no whole one yet.

        last: whether no more bytes will come.
        """


class HalfDuplex(ABC):
    """A half-duplex serial line; subclasses add the requests and answers of their protocol.

    Not thread-safe: one owner. Every method raises PortError when the port fails; a servo that does
    not answer is no error but a missing status. Nothing is sent before the computed end of the last
    transaction.
    echoes: whether the adapter returns the bytes sent; detected, and the echo is then removed.
    extra_wait_s: further seconds to wait for an answer; for commands outside the control loop.
    heard_noise: whether bytes came in the last transaction, but no valid answer.
    """

    def __init__(self, transport: Transport, return_delay_s: float, extra_wait_s: float) -> None:
        """Use the line behind `transport`, an open port.

        return_delay_s: seconds that the slowest servo waits before it answers; added to deadlines.
        """
        self.transport = transport
        self.return_delay_s = return_delay_s
        self.byte_s = BITS_PER_BYTE / transport.baud_rate
        self.latency = LearntLatency()
        self.extra_wait_s = extra_wait_s
        self.echoes = False
        self.heard_noise = False
        self._clock = transport.clock
        self._heard = b""  # the bytes that came after the last request
        self._quiet_s = 0.0  # when no reply is on the wire any more
        self._sent_s = 0.0  # when the last byte of the last request is sent
        self._pending = PendingAnswers()

    @property
    def baud_rate(self) -> int:
        """Bits per second on the wire."""
        return self.transport.baud_rate

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None:
        self.transport.baud_rate = baud_rate
        self.byte_s = BITS_PER_BYTE / baud_rate

    @abstractmethod
    def read(self, servo_id: int, address: int, size: int) -> Any:
        """Read `size` bytes of one servo from `address` on: a status with `data`; None: silent."""

    @abstractmethod
    def write(self, servo_id: int, address: int, data: bytes) -> object:
        """Write bytes of one servo from `address` on. Read them back: an answer proves nothing."""

    def tell(self, request: bytes) -> None:
        """Send a request that has no answer."""
        self._send(request)

    def _send(self, request: bytes) -> float:
        """Wait until the line is quiet and write `request`; return when its last byte is sent.

        The return value is computed from the baud rate, in s of the clock: the write itself returns
        earlier. Raises PortError.
        """
        now_s = self._clock.now()
        if now_s < self._quiet_s:
            self._clock.sleep_until(self._quiet_s)
            now_s = self._clock.now()
        self.transport.write(request)
        # An earlier request without an answer may still be leaving.
        begin_s = now_s if now_s > self._sent_s else self._sent_s
        self._sent_s = begin_s + len(request) * self.byte_s
        return self._sent_s

    def _transact(
        self,
        request: bytes,
        reply_size: int,
        take: "Take[_Answer]",
        is_over: Callable[[bytes], bool] = lambda _: False,
        *,
        n_answers: int = 1,
        extra_wait_s: float = 0.0,
    ) -> _Answer | None:
        """Send a request, and read until `take` returns an answer; None: none came in time.

        take: parses the bytes received so far (see `Take`). reply_size: bytes of the whole reply.
        is_over: returns whether no more bytes can follow those received. n_answers: how many servos
        answer, each after its return delay. extra_wait_s: added to the deadline, and nothing is
        learnt from the reply's delay then. Blocks until the answer, or the deadline: the reply's
        time on the wire and the learnt latency.
        """
        transport, clock = self.transport, self._clock
        extra_wait_s = max(extra_wait_s, self.extra_wait_s)
        transport.discard_input()
        # due_s: the reply's last byte, if servos answer at once. wire_end_s: the latest without
        # latency of adapter and computer.
        due_s = self._send(request) + reply_size * self.byte_s
        wire_end_s = due_s + n_answers * self.return_delay_s
        deadline_s = wire_end_s + self.latency.slack_s + extra_wait_s
        clock.sleep_until(due_s)
        heard = transport.read(deadline_s)
        late = 0
        while True:
            # The usual case needs no search for an echo: exactly the reply came.
            if len(heard) == reply_size and not self.echoes and not heard.startswith(request):
                stream, ended = heard, False
            else:
                stream = self._without_echo(heard, request)
                ended = is_over(stream)
            if ended or len(stream) >= reply_size:
                taken = take(stream, last=ended)
                if taken is not None:
                    self._heard = stream
                    self._quiet_s = clock.now()
                    if not extra_wait_s:
                        self.latency.learn(self._quiet_s - due_s)
                    self.heard_noise = False
                    return taken
            # Part of the reply is here: wait only a little for the rest.
            if stream and not extra_wait_s:
                rest_s = max(wire_end_s, clock.now()) + self.latency.rest_slack_s
                deadline_s = min(deadline_s, rest_s)
            # Past the deadline one more read gets the bytes that have come already; only one, since
            # a line with constant noise never falls silent.
            late += clock.now() > deadline_s
            more = transport.read(deadline_s) if late <= 1 else b""
            if not more:
                self._heard = stream
                self._quiet_s = max(wire_end_s, clock.now())
                taken = take(stream, last=True)
                self.heard_noise = bool(stream) and not taken
                return taken
            heard += more

    def _without_echo(self, heard: bytes, request: bytes) -> bytes:
        """Return the bytes of `heard` after an echo of `request`; all of them if there is no echo.

        Sets `echoes` if there is one. Bytes before the echo cannot answer this request, since the
        line carries one message at a time.
        """
        at = heard.find(request)
        if at < 0:
            return heard
        self.echoes = True
        return heard[at + len(request) :]
