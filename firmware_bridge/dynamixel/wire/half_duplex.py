"""Sending and hearing on one half-duplex line: who may speak when, and how long to listen."""

from collections.abc import Callable, Sequence
from typing import Final, Protocol

from firmware_bridge.dynamixel.wire.codec import BITS_PER_BYTE, Instruction, Status
from firmware_bridge.dynamixel.wire.frames import FrameParser
from firmware_bridge.dynamixel.wire.latency import LearntLatency
from firmware_bridge.dynamixel.wire.transport import Transport

#: An int: looking a member up in its enumeration costs as much as comparing three.
_STATUS: Final = int(Instruction.STATUS)


class HalfDuplex:
    """Nothing is sent before the computed end of the last transaction. It knows no instruction.

    echoes: the adapter gives back what is sent, which is found out by itself and swallowed.
    extra_wait_s: how long beyond its time an answer is waited for; for commands outside the loop.
    n_bad: damaged packets heard; heard_noise: something came last time, but no valid packet.
    """

    def __init__(self, transport: Transport, return_delay_s: float) -> None:
        """return_delay_s: the slowest servo's; it lengthens deadlines, not the wire."""
        self.transport = transport
        self.return_delay_s = return_delay_s
        self.byte_s = BITS_PER_BYTE / transport.baud_rate
        self.latency = LearntLatency()
        self.extra_wait_s = 0.0
        self.echoes = False
        self.n_bad = 0
        self.heard_noise = False
        self._clock = transport.clock
        self._parser = FrameParser()
        self._heard = b""  # in answer to the last question
        self._quiet_s = 0.0  # from here on no reply is on the wire any more
        self._sent_s = 0.0  # here our own last byte is

    @property
    def baud_rate(self) -> int:
        """Bits a second on the wire."""
        return self.transport.baud_rate

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None:
        self.transport.baud_rate = baud_rate
        self.byte_s = BITS_PER_BYTE / baud_rate

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
        take: "Take",
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


class Take(Protocol):
    """Makes statuses of a stream; None while it wants more, never when `last`."""

    def __call__(self, stream: bytes, *, last: bool) -> Sequence[Status] | None:
        """Take what can be taken."""
