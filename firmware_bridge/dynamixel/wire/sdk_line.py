"""The vendor's dynamixel-sdk in place of our own codec: for compatibility and for comparison.

It polls, and gives no partial reads: one silent servo costs a group all its samples
(docs/benchmarks.md). Its failures of the port, three kinds of exception, become PortGone here.
"""

import struct
import termios
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from firmware_bridge.clock import Clock, MonotonicClock
from firmware_bridge.dynamixel.wire.codec import FrameParser, Instruction, SpanRead, Status
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.errors import PortError, PortGone
from firmware_bridge.serial_servos.serial_transport import claim, explain, release

_Result = TypeVar("_Result")


class SdkTransport:
    """The SDK's port, kept open for one `SdkLine`."""

    def __init__(self, port: str, baud_rate: int) -> None:
        """Open the port. Raises PortError when the SDK cannot open it at this baud rate."""
        self.port = port
        self.clock: Clock = MonotonicClock()
        self.handler = PortHandler(port)
        try:
            opened = self.handler.openPort() and self.handler.setBaudRate(baud_rate)
            if opened:
                claim(self.handler.ser)
        except OSError as error:
            self.close()
            raise PortError(explain(port, error)) from error
        except termios.error as error:
            raise PortError(f"{port}: is not a serial port") from error
        if not opened:
            raise PortError(f"{port}: does not open at {baud_rate:,} baud; is it in use?")
        self._baud_rate = baud_rate

    @property
    def baud_rate(self) -> int:
        """Bits a second on the wire."""
        return self._baud_rate

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None:
        self._baud_rate = baud_rate
        self.call(lambda: self._reopen(baud_rate))

    def _reopen(self, baud_rate: int) -> None:
        """Set the baud rate by opening the port anew, without the exclusive lock meanwhile.

        The SDK can set a rate in no other manner, and the lock would keep out this process as well.
        """
        release(self.handler.ser)
        self.handler.setBaudRate(baud_rate)
        claim(self.handler.ser)

    def call(self, ask: Callable[[], _Result]) -> _Result:
        """Return the result of `ask`, a call of the SDK. Raises PortGone when the port fails.

        The SDK's mark that the port is in use is cleared in any case: after an error it would stay,
        and every later call be refused.
        """
        try:
            return ask()
        except (OSError, termios.error) as error:  # OSError: pyserial's exceptions, too
            raise PortGone(f"{self.port}: gone ({error}); plug the adapter in again") from error
        finally:
            self.handler.is_using = False

    def write(self, data: bytes) -> None:
        """Send bytes unchanged."""
        self.call(lambda: self.handler.writePort(data))

    def read(self, deadline_s: float) -> bytes:
        """Return the bytes that the SDK's port has received; does not wait for `deadline_s`."""
        del deadline_s
        return bytes(self.call(lambda: self.handler.readPort(4096)))

    def discard_input(self) -> bytes:
        """Discard the bytes that have arrived; return b""."""
        self.call(self.handler.clearPort)
        return b""

    def close(self) -> None:
        """Close the port."""
        if self.handler.is_open:
            release(self.handler.ser)
            self.handler.closePort()


class SdkLine(Line):
    """A `Line` whose every packet is made and parsed by dynamixel-sdk."""

    def __init__(self, transport: SdkTransport) -> None:
        super().__init__(transport)
        self._sdk = transport
        self._packets = PacketHandler(2.0)

    def _ask(self, ask: Callable[..., Any], *of: object) -> Any:
        return self._sdk.call(lambda: ask(self._sdk.handler, *of))

    def ping(self, servo_id: int, extra_wait_s: float = 0.0) -> Status | None:
        """Ping one servo; return model number and 0, for the SDK omits firmware; None: silent."""
        del extra_wait_s  # the SDK's own is 34 ms
        number, result, error = self._ask(self._packets.ping, servo_id)
        return Status(servo_id, error, struct.pack("<HB", number, 0)) if not result else None

    def ping_all(self) -> list[Status]:
        """Return a status of every servo that answers a broadcast ping."""
        found, _ = self._ask(self._packets.broadcastPing)
        return [
            Status(each, 0, struct.pack("<HB", *model_and_firmware))
            for each, model_and_firmware in found.items()
        ]

    def read(
        self, servo_id: int, address: int, size: int, extra_wait_s: float = 0.0
    ) -> Status | None:
        """Read `size` bytes of one servo from `address` on; None if it does not answer.

        extra_wait_s is ignored.
        """
        del extra_wait_s
        data, result, error = self._ask(self._packets.readTxRx, servo_id, address, size)
        return Status(servo_id, error, bytes(data)) if result == COMM_SUCCESS else None

    def write(
        self, servo_id: int, address: int, data: bytes, extra_wait_s: float = 0.0
    ) -> Status | None:
        """Set bytes of one servo from `address` on; return its status, None if it is silent.

        The SDK waits 34 ms; extra_wait_s is ignored.
        """
        del extra_wait_s
        values = len(data), list(data)
        result, error = self._ask(self._packets.writeTxRx, servo_id, address, *values)
        return Status(servo_id, error, b"") if result == COMM_SUCCESS else None

    def reboot(self, servo_id: int) -> Status | None:
        """Restart one servo; return its status, None if it does not answer."""
        result, error = self._ask(self._packets.reboot, servo_id)
        return Status(servo_id, error, b"") if result == COMM_SUCCESS else None

    def tell(self, request: bytes) -> None:
        """Send a sync write, made anew by the SDK. Raises ValueError for any other instruction."""
        (frame,) = FrameParser().feed(request)
        if frame.instruction != Instruction.SYNC_WRITE:
            raise ValueError(f"dynamixel-sdk cannot send instruction {frame.instruction}")
        address, size = struct.unpack_from("<HH", frame.parameters)
        group = GroupSyncWrite(self._sdk.handler, self._packets, address, size)
        for at in range(4, len(frame.parameters), size + 1):
            block = frame.parameters[at : at + size + 1]
            group.addParam(block[0], list(block[1:]))
        self._sdk.call(group.txPacket)

    def sync_read(self, span: SpanRead) -> Sequence[Status]:
        """Send request `span`; return the statuses of all servos, error 0 in each.

        [] if any servo did not answer: the SDK discards partial answers, and error bytes.
        """
        group = GroupSyncRead(self._sdk.handler, self._packets, span.address, span.size)
        for servo_id in span.ids:
            group.addParam(servo_id)
        try:
            result = self._sdk.call(group.fastSyncRead if span.fast else group.txRxPacket)
        except IndexError:  # a late answer of another length meets a fast read
            return []
        if result != COMM_SUCCESS:
            return []
        return [Status(each, 0, bytes(group.data_dict[each])) for each in span.ids]
