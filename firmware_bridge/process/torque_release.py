"""Switch torque off where no bridge (driving process) runs any more: make every servo limp."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from firmware_bridge.bus_kinds import NOT_SEEN, PortRelease
from firmware_bridge.errors import BusError, PortError

#: Each servo that has not confirmed is polled this often at least.
_REPEATS: Final = 3
_RETRY_S: Final = 0.05


class TorqueRelease:
    """Torque off by force at one port, one small step a call, so that the caller's loop continues.

    confirmed: addresses of servos that were read limp; released: of those that were sent torque off
    and cannot confirm it; unconfirmed: by address, why each other servo was not read limp;
    port_error: why the port cannot be opened now, empty: it can.
    """

    def __init__(
        self,
        open_port: Callable[[], PortRelease],
        addresses: Sequence[int],
        *,
        timeout_s: float = 0.0,
        searches: bool = False,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare to switch off the servos at `addresses`; `step` opens the port by `open_port`.

        timeout_s: how long silent servos are polled again; three times at least. searches: whether
        other servos that are found at the port are polled, too.
        """
        self._open_port = open_port
        self._addresses = tuple(addresses)
        self._timeout_s = timeout_s
        self._searches = searches
        self._now_s = now_s
        self._port: PortRelease | None = None
        self._opened_s = 0.0
        self._left: list[int] = []
        self._n_rounds = 0
        self.next_s = 0.0
        self.done = False
        self.port_error = ""
        self.confirmed: list[int] = []
        self.released: list[int] = []
        self.unconfirmed: dict[int, str] = dict.fromkeys(self._addresses, NOT_SEEN)

    def step(self) -> bool:
        """Open the port and send torque off, or poll one servo; return whether the release is over.

        Never raises BusError: a port that fails is opened again later.
        """
        if self.done:
            return True
        try:
            if self._port is None:
                self._open()
            elif self._left:
                self._ask(self._port, self._left.pop(0))
            else:
                self._next_round(self._port)
        except BusError as error:
            self.close()
            self.port_error = str(error)
            self.next_s = self._now_s() + _RETRY_S
        return self.done

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _open(self) -> None:
        """Open the port, send torque off and begin a new report. Raises BusError."""
        port = self._port = self._open_port()
        self.port_error = ""
        self._opened_s = self._now_s()
        self._n_rounds = 0
        self.confirmed = []
        addresses: Sequence[int] = self._addresses
        if self._searches:
            addresses = port.find(addresses)
        else:
            port.tell_all(addresses)
        self.unconfirmed = dict.fromkeys(addresses, NOT_SEEN)
        if not port.confirms:
            self.released, self.unconfirmed = list(addresses), {}

    def _next_round(self, port: PortRelease) -> None:
        """Send torque off again and begin to poll all unconfirmed servos; or end the release.

        It ends when all have confirmed, or after three rounds and `timeout_s`. Raises BusError.
        """
        if self._n_rounds:
            port.tell_all(list(self.unconfirmed))
        waited_s = self._now_s() - self._opened_s
        enough = self._n_rounds >= _REPEATS and waited_s >= self._timeout_s
        if not self.unconfirmed or enough:
            self.close()
            self.done = True
            return
        self._left = list(self.unconfirmed)
        self._n_rounds += 1

    def _ask(self, port: PortRelease, address: int) -> None:
        """Poll one servo, and store whether it confirmed torque off. Raises PortError."""
        if why := port.ask(address):
            self.unconfirmed[address] = why
        else:
            del self.unconfirmed[address]
            self.confirmed.append(address)


class FaceRelease:
    """Torque off by force at every port of a face; servos are named as in the face.

    Of several ports each has a thread, so that none waits for another.
    """

    def __init__(self, ports: Sequence[tuple[TorqueRelease, Mapping[int, str]]]) -> None:
        """Prepare the release of `ports`, each (its release, its servos' names by address)."""
        self._ports = tuple(ports)
        self._is_over = threading.Event()
        self._threads: list[threading.Thread] = []
        self._look_s = 0.0

    def step(self) -> bool:
        """Run the next step at every port; return whether all are over. Never raises BusError."""
        if len(self._ports) == 1:
            return self._ports[0][0].step()
        if not self._threads:
            self._threads = [
                threading.Thread(target=self._run, args=(each,), name="release", daemon=True)
                for each, _ in self._ports
            ]
            for thread in self._threads:
                thread.start()
        self._look_s = time.monotonic() + _RETRY_S
        return not any(thread.is_alive() for thread in self._threads)

    @property
    def next_s(self) -> float:
        """The monotonic time at which `step` must be called next."""
        return self._ports[0][0].next_s if len(self._ports) == 1 else self._look_s

    @property
    def port_error(self) -> str:
        """Why ports cannot be opened now, joined in one text; empty: all are open or done."""
        return "; ".join(each.port_error for each, _ in self._ports if each.port_error)

    @property
    def let_go(self) -> list[str]:
        """The names of servos that were read limp, or were sent torque off but cannot confirm."""
        return [
            names.get(address, f"address {address}")
            for each, names in self._ports
            for address in (*each.confirmed, *each.released)
        ]

    @property
    def unconfirmed(self) -> dict[str, str]:
        """The reasons why servos were not confirmed limp, by the servos' names."""
        return {
            names.get(address, f"address {address}"): each.port_error or why
            for each, names in self._ports
            for address, why in each.unconfirmed.items()
        }

    def close(self) -> None:
        """Close the ports; a port that hangs keeps its thread, and no other port waits for it."""
        self._is_over.set()
        for thread in self._threads:
            thread.join(_RETRY_S)
        if not self._threads:
            for each, _ in self._ports:
                each.close()

    def _run(self, release: TorqueRelease) -> None:
        while not (self._is_over.is_set() or release.step()):
            self._is_over.wait(max(0.0, release.next_s - time.monotonic()))
        release.close()


def release_port(
    open_port: Callable[[], PortRelease], addresses: Sequence[int] = (), *, timeout_s: float = 0.0
) -> TorqueRelease:
    """Send torque off to all servos at a port, poll every servo found, and return the release.

    The release is over; its `confirmed`, `released` and `unconfirmed` list the servos. addresses:
    servos that are polled even if they are not found. Waits up to `timeout_s` for the port. Raises
    PortError when it cannot be opened.
    """
    release = TorqueRelease(open_port, addresses, searches=True)
    give_up_s = time.monotonic() + timeout_s
    while not release.step():
        if release.port_error and time.monotonic() >= give_up_s:
            raise PortError(release.port_error)
        if release.port_error:
            time.sleep(_RETRY_S)
    return release
