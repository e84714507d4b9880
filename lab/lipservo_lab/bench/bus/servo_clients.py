"""dynamixel-sdk and rustypot as servo clients: goals out, places and health back in one call.

A servo loop as one writes it with either, a process of its own.

Run as `python -m lipservo_lab.bench.bus.servo_clients KIND PORT BAUD_RATE N RATE_HZ TARGETS COUNT`,
KIND one of `CLIENTS`, the last two inherited descriptors: a socket that goals come through, in
degrees, as they come to the bridge; and eight bytes of memory in which it counts its rounds. It
ends when the socket closes.
"""

import gc
import mmap
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, Protocol

import numpy as np

#: goal_position; present_current, present_velocity, present_position; voltage, temperature.
_GOAL, _MOTION, _MOTION_SIZE, _WARMTH, _WARMTH_SIZE = 116, 126, 10, 144, 3
#: torque_enable .. bus_watchdog: what a tick of ours reads of one servo, the next in turn.
_HEALTH, _HEALTH_SIZE, _ERROR_AT = 64, 35, 6
_MOTION_TYPE = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
_WARMTH_TYPE = np.dtype([("voltage", "<u2"), ("temperature", "u1")])
BAUD_RATE: Final = 4_000_000


class AnswerLost(Exception):  # noqa: N818 - no mistake of anybody: the computer was busy
    """An answer, or its end, came too late; this call does not count."""


class ServoClient(Protocol):
    """Sends goals to servos 1..n and reads their state."""

    def work(self, goals: Sequence[int]) -> object:
        """Write goals and read all values once. goals: position registers, one a servo.

        Raises AnswerLost.
        """


class SdkClient:
    """dynamixel-sdk, as its own examples use it: voltage and temperature of all, a frame each."""

    def __init__(self, port: str, n_servos: int, baud_rate: int = BAUD_RATE) -> None:
        import dynamixel_sdk as sdk

        self._success = sdk.COMM_SUCCESS
        self._ids = range(1, n_servos + 1)
        handler = sdk.PortHandler(port)
        handler.openPort()
        handler.setBaudRate(baud_rate)
        packets = sdk.PacketHandler(2.0)
        self._write = sdk.GroupSyncWrite(handler, packets, _GOAL, 4)
        self._motion = sdk.GroupSyncRead(handler, packets, _MOTION, _MOTION_SIZE)
        self._warmth = sdk.GroupSyncRead(handler, packets, _WARMTH, _WARMTH_SIZE)
        for servo_id in self._ids:
            # 2048, the middle position, low byte first; `work` replaces it before it is sent.
            self._write.addParam(servo_id, [0, 8, 0, 0])
            self._motion.addParam(servo_id)
            self._warmth.addParam(servo_id)

    def work(self, goals: Sequence[int]) -> list[list[int]]:
        """Write all goals (pulses); return currents, positions, voltages and temperatures of all.

        Raises AnswerLost.
        """
        for servo_id, goal in zip(self._ids, goals, strict=True):
            self._write.changeParam(servo_id, list(goal.to_bytes(4, "little")))
        self._write.txPacket()
        try:
            results = [self._motion.fastSyncRead(), self._warmth.txRxPacket()]
        except IndexError as error:  # it took a late answer for that to another question
            raise AnswerLost from error
        if results != [self._success] * len(results):
            raise AnswerLost
        return [
            self._values(self._motion, _MOTION, 2),
            self._values(self._motion, _MOTION + 6, 4),
            self._values(self._warmth, _WARMTH, 2),
            self._values(self._warmth, _WARMTH + 2, 1),
        ]

    def _values(self, group: Any, address: int, size: int) -> list[int]:
        return [
            group.getData(servo_id, address, size)
            for servo_id in self._ids
            if group.isAvailable(servo_id, address, size)
        ]


class RustypotClient:
    """rustypot, which decodes single registers only: spans come as bytes, by fast reads.

    Health is read as our tick does: of one servo, the next in turn.
    """

    def __init__(self, port: str, n_servos: int, baud_rate: int = BAUD_RATE) -> None:
        import rustypot

        self._ids = list(range(1, n_servos + 1))
        self._bus = rustypot.Xl330PyController(port, baud_rate, 0.1)
        self._bus.set_fast_sync_read(True)
        self._turn = 0

    def work(self, goals: Sequence[int]) -> list[list[int]]:
        """Write all goals (pulses); return currents and positions of all, and health of one servo.

        Raises AnswerLost.
        """
        self._bus.sync_write_raw_goal_position(self._ids, list(goals))
        motion = self._read(self._ids, _MOTION, _MOTION_SIZE, _MOTION_TYPE)
        return [motion["current"].tolist(), motion["position"].tolist(), self._next_health()]

    def _next_health(self) -> list[int]:
        """Read the health of the next servo in turn.

        Torque, hardware error and watchdog in one call; voltage and temperature in the next.
        """
        turn, is_heat_turn = divmod(self._turn, 2)
        self._turn = (self._turn + 1) % (2 * len(self._ids))
        if is_heat_turn:
            (values,) = self._read([self._ids[turn]], _WARMTH, _WARMTH_SIZE, _WARMTH_TYPE).tolist()
            return [*values]
        data = self._read_raw([self._ids[turn]], _HEALTH, _HEALTH_SIZE)[0]
        return [data[0], data[_ERROR_AT], data[-1]]

    def _read_raw(self, ids: list[int], address: int, size: int) -> Any:
        try:
            return self._bus.sync_read_raw_data(ids, address, size)
        except RuntimeError as error:
            raise AnswerLost from error

    def _read(self, ids: list[int], address: int, size: int, dtype: np.dtype) -> np.ndarray:
        answers = self._read_raw(ids, address, size)
        return np.frombuffer(b"".join([bytes(each) for each in answers]), dtype=dtype)


#: By name.
CLIENTS: Final[dict[str, Callable[[str, int, int], ServoClient]]] = {
    "sdk": SdkClient,
    "rustypot": RustypotClient,
}


@contextmanager
def canned_peer(n_servos: int, *, on_time: bool = False) -> Iterator[str]:
    """Run a process that answers at once for `n_servos` servos, with changing data; yield its port.

    on_time: it gets real-time scheduling, where permitted.
    """
    command = [sys.executable, "-P", "-m", "lipservo_lab.bench.bus.canned_peer", str(n_servos)]
    options = ["--on-time"] if on_time else []
    with subprocess.Popen(
        [*command, str(_MOTION_SIZE), *options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as peer:
        assert peer.stdout is not None
        yield peer.stdout.readline().strip()
        peer.terminate()


#: Number and time of a record, before its angles.
_HEAD_BYTES: Final = 16
_LONGEST: Final = 4096
_COUNT: Final = struct.Struct("<Q")
_CENTER, _PULSES_PER_DEG = 2048, 4096 / 360


def run(client: ServoClient, n_servos: int, rate_hz: float, targets: int, count: int) -> int:
    """Write the newest goals and read all values in every period, as a plain program would.

    There are no limits, no stop, no status. targets, count: file descriptors of the socket with
    targets, in degrees, and of the shared memory that counts rounds. Returns the number of lost
    answers once the socket is closed.
    """
    angles_layout, poll = struct.Struct(f"<{n_servos}d"), select.poll()
    gc.collect()
    gc.freeze()
    with socket.socket(fileno=targets) as target_socket, mmap.mmap(count, 0) as round_counter:
        poll.register(target_socket, select.POLLIN)
        goals = [_CENTER] * n_servos
        n, n_lost, due_s = 0, 0, time.monotonic()
        while True:
            wait_s = due_s - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            due_s = max(due_s + 1.0 / rate_hz, time.monotonic())
            while poll.poll(0):
                record = target_socket.recv(_LONGEST)
                if not record:
                    return n_lost
                goals = [
                    _CENTER + round(deg * _PULSES_PER_DEG)
                    for deg in angles_layout.unpack_from(record, _HEAD_BYTES)
                ]
            try:
                client.work(goals)
            except AnswerLost:
                n_lost += 1
            n += 1
            _COUNT.pack_into(round_counter, 0, n)


if __name__ == "__main__":
    kind, port, *numbers = sys.argv[1:]
    baud_rate, n_servos, targets, count = (int(numbers[n]) for n in (0, 1, 3, 4))
    client = CLIENTS[kind](port, n_servos, baud_rate)
    run(client, n_servos, float(numbers[2]), targets, count)
