"""What the buses of serial servos share: port, torque of one and of all, start and end."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.errors import PortError
from firmware_bridge.known_torque import KnownTorque
from firmware_bridge.serial_servos.half_duplex import HalfDuplex
from firmware_bridge.serial_servos.mounting import MountedServo, Mounting
from firmware_bridge.serial_servos.state_cache import ServoStateCache
from firmware_bridge.serial_servos.torque import SerialTorqueSwitch

#: Torque off is sent this often before it is read back: a lost packet must not leave torque on.
_LIMP_REPEATS: Final = 3
_ECHO: Final = "the adapter gives back what is sent to the servos; that is swallowed"
_Line = TypeVar("_Line", bound=HalfDuplex)


class SerialBus(ABC, Generic[_Line]):
    """Servos on one serial line; a subclass adds the packets of its kind, and the methods of ticks.

    A servo that falls silent costs its own samples only. When the port fails every method raises
    PortGone until `reopen` succeeds. Never writes EEPROM.
    """

    _torque: SerialTorqueSwitch[_Line]
    #: Prepared reads of the same registers of all servos; `_holding`: of torque_enable alone.
    _groups: tuple[Any, ...]
    _holding: Any

    def __init__(
        self,
        servos: Sequence[MountedServo[Any]],
        open_line: Callable[[], _Line],
        present: Any,
        *,
        strict: bool,
    ) -> None:
        """Make a bus of these servos, closed until `__enter__`; then opened by `open_line`.

        present: the `PresentState` of their family, which stores what servos answer. strict: every
        servo must answer before the first goal; otherwise servos may be missing, but neither a
        critical one nor all.
        """
        self._servos = tuple(servos)
        self._ids = [servo.joint.servo_id for servo in servos]
        self._open_line = open_line
        self._strict = strict
        self._mounting = Mounting(servos)
        self._present = present
        self._cache: ServoStateCache = present.cache
        self._index = self._cache.index
        self._remarks: tuple[str, ...] = ()
        self._turn = 0  # whose turn it is in `look_after`
        self._line: _Line | None = None  # None: the port is closed

    @property
    def torque(self) -> KnownTorque:
        """What is known of every servo's torque, from reads of its register alone."""
        return self._cache.torque

    @property
    def at_full_strength(self) -> bool:
        """Whether every servo with torque on has its full speed and strength."""
        return self._torque.at_full_strength

    @property
    def line(self) -> _Line:
        """The open line. Raises PortError when no line is open."""
        if self._line is None:
            raise PortError("the bus is used outside its `with` block, or its port is gone")
        return self._line

    def widen(self, joints: NDArray[np.bool_]) -> None:
        """Do nothing: only hobby servos accept goals beyond their joints' limits.

        Parameters
        ----------
        joints : NDArray[np.bool_]
            (n_servos,), ignored.
        """

    def obstacle(self, index: int) -> str:
        """Return why servo `index` cannot hold its position; empty: it can.

        Read anew before torque comes on: the servo may have been replaced, or set up elsewhere.
        """
        return self._torque.obstacle(self.line, index)

    def forgive(self, _index: int) -> None:
        """Do nothing: what is wrong with such a servo is read from it each time."""

    def enable_torque(self, index: int) -> str:
        """Switch one servo's torque on without motion; return why it stays off, "" if confirmed.

        What it needs is checked or set before, and each read back before the next.
        """
        return self._torque.enable(self.line, index)

    def keep_torque(self, index: int) -> bool:
        """Hold a servo whose torque is on at its present position; return whether it confirmed."""
        return self._torque.keep(self.line, index)

    def disable_torque(self, index: int) -> bool:
        """Switch one servo's torque off; return whether a read confirms it."""
        return self._torque.disable(self.line, index)

    def disable_all(self) -> NDArray[np.bool_]:
        """Switch the torque of all servos off; return which servos confirmed.

        One packet to all is sent three times, then `torque_enable` is read up to three times.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True where a read showed that torque is off.
        """
        line = self.line
        self._torque.cancel()
        self.torque.forget()
        request = self._all_off()
        for _ in range(_LIMP_REPEATS):
            line.tell(request)
        confirmed = np.zeros(len(self._ids), dtype=np.bool_)
        self._holding.reset()  # so that servos that were silent lately are read, too
        for _ in range(_LIMP_REPEATS):
            for status in self._ask_torque(line):
                n = self._index[status.servo_id]
                confirmed[n] = status.data == b"\0"
                self._torque.note(n, status.data, line.transport.clock.now())
            if confirmed.all():
                break
            line.tell(request)
        self._cache.enabled[confirmed] = False
        return confirmed

    def remarks(self) -> Sequence[str]:
        """Return what is unusual about adapter and servos, in sentences for a log."""
        if self._line is not None and self._line.echoes and _ECHO not in self._remarks:
            self._remarks += (_ECHO,)
        return self._remarks

    def reopen(self) -> None:
        """Open the port again with a new handle. Raises PortError."""
        self._close()
        self._begin(self._open_line())

    def __enter__(self) -> Self:
        """Open the port, identify all servos and store their own limits; torque stays as it is.

        Raises PortError, and ServoError for servos that are missing or differ from the face's YAML.
        """
        line = self._open_line()
        try:
            for n, found in enumerate(self._identities(line)):
                if found is not None:
                    self._torque.take_identity(n, found, line.transport.clock.now())
            self._begin(line)
            self._remarks = tuple(self._first_remarks())
        except BaseException:
            self._line = None
            line.transport.close()
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        """Switch all torque off unless this bus has confirmed that it is off, and close the port.

        Torque off cannot be sent over a lost port: that port is closed, and no error is raised.
        """
        try:
            if self._line is not None and self._cache.enabled.any():
                self.disable_all()
        except PortError:
            pass  # the port is lost
        finally:
            self._close()

    @abstractmethod
    def _identities(self, line: _Line) -> Sequence[Any]:
        """Identify every servo, in the face's order; None: a silent one. Raises ServoError."""

    @abstractmethod
    def _first_remarks(self) -> Iterable[str]:
        """Return what is unusual at the start."""

    @abstractmethod
    def _all_off(self) -> bytes:
        """Return the packet that switches the torque of all servos off."""

    @abstractmethod
    def _ask_torque(self, line: _Line) -> Iterable[Any]:
        """Read torque_enable of all servos; return the statuses that came."""

    def _begin(self, line: _Line) -> None:
        """Use the open `line` from now on, with the answer deadline that the slowest servo needs.

        Every servo's torque becomes unknown, and no read counts it as silent.
        """
        self._line = line
        self.torque.forget()
        line.return_delay_s = float(self._cache.return_delay_s.max())
        for group in self._groups:
            group.reset()

    def _close(self) -> None:
        if self._line is not None:
            self._line.transport.close()
            self._line = None
