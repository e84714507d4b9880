"""Servos with torque off, for a person who turns them with the fingers.

Torque is only ever switched off here, so that whatever ends the program leaves it off.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from firmware_bridge.bus import ServoBus
from firmware_bridge.clock import Clock
from firmware_bridge.errors import PortError
from firmware_bridge.known_torque import Torque
from firmware_bridge.stopping import StopReport
from lipservo.settings.settings import FaceSettings
from lipsync.arrays import Array

if TYPE_CHECKING:
    from rich.table import Table

#: Torque off is requested so often before a servo counts as not having confirmed it.
_TRIES: Final = 3
#: Encoders are read at this interval; a pose must be still for so many readings: fingers tremble
#: faster.
READ_EVERY_S: Final = 0.05
STEADY_READINGS: Final = 7
#: A joint that a hand holds still wanders by less, play included; more is a moving hand.
_STEADY_DEG: Final = 1.0
_HOLDS: Final = "holds: its torque is on; who else drives it?"
_MOVES: Final = "still moves; hold it still"
_SILENT: Final = "does not answer; check its power and cable"


@dataclass(frozen=True, slots=True)
class LimpPose:
    """The joint positions of limp servos: (n_servos,) degrees, NaN for a servo without a reading.

    obstacles: reasons why the pose cannot be stored, by servo name; empty: it can be stored.
    """

    positions_deg: Array
    obstacles: dict[str, str]


class LimpServos:
    """Servos of an open bus whose torque is switched off and whose positions are read."""

    def __init__(
        self,
        settings: FaceSettings,
        bus: ServoBus,
        clock: Clock,
        names: Sequence[str] | None = None,
    ) -> None:
        """Select servos of the face `settings`, for which `bus` must have been made.

        names: of the servos; None: the mouth's, in the order of the YAML.
        """
        self.names = tuple(settings.mouth_servos if names is None else names)
        self._bus, self._clock = bus, clock
        self._indices = [list(settings.servos).index(name) for name in self.names]

    def let_go(self) -> StopReport:
        """Switch torque off in each servo; report which confirmed it. Never raises PortError."""
        confirmed, unconfirmed = [], {}
        for name, index in zip(self.names, self._indices, strict=True):
            try:
                if any(self._bus.disable_torque(index) for _ in range(_TRIES)):
                    confirmed.append(name)
                else:
                    unconfirmed[name] = _SILENT
            except PortError as error:
                unconfirmed[name] = str(error)
        return StopReport(tuple(confirmed), unconfirmed)

    def read_pose(self) -> LimpPose:
        """Read the servos' positions, in degrees, now. Raises PortGone.

        Obstacles in the result: servos that did not answer, or whose torque is on.
        """
        feedback = self._bus.read()
        positions_deg = feedback.positions_deg[self._indices]
        silent, held = feedback.missing[self._indices], feedback.torque[self._indices] == Torque.ON
        obstacles: dict[str, str] = {}
        for n, name in enumerate(self.names):
            if silent[n]:
                obstacles[name] = _SILENT
            elif held[n]:
                obstacles[name] = _HOLDS
        return LimpPose(positions_deg, obstacles)

    def steady_pose(self) -> LimpPose:
        """Return the median pose of 7 readings over 0.3 s, with obstacles. Raises PortGone."""
        readings = []
        for n in range(STEADY_READINGS):
            if n:
                self._clock.sleep_until(self._clock.now() + READ_EVERY_S)
            readings.append(self.read_pose())
        return self.steady(readings)

    def steady(self, readings: Sequence[LimpPose]) -> LimpPose:
        """Return the median positions of several readings, with the reasons against storing them.

        A servo is an obstacle if it held torque in any reading, was silent in most, or moved by
        over 1 deg. A servo that never answered has position NaN.
        """
        medians_deg: list[float] = []
        obstacles: dict[str, str] = {}
        for n, name in enumerate(self.names):
            found_obstacles = [reading.obstacles.get(name, "") for reading in readings]
            read_deg = [
                float(reading.positions_deg[n])
                for reading in readings
                if reading.obstacles.get(name) != _SILENT
            ]
            medians_deg.append(float(np.median(read_deg)) if read_deg else math.nan)
            if _HOLDS in found_obstacles:
                obstacles[name] = _HOLDS
            elif 2 * len(read_deg) < len(readings):
                obstacles[name] = _SILENT
            elif np.ptp(read_deg) > _STEADY_DEG:
                obstacles[name] = _MOVES
        return LimpPose(np.array(medians_deg), obstacles)


class TurnedRange:
    """The ranges, in degrees, over which limp joints were turned by hand. Arrays: (n_servos,)."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self.begin()

    def begin(self) -> None:
        """Forget the ranges of all joints, to begin anew."""
        nothing = np.full(len(self._names), np.nan)
        self._here_deg, self._least_deg, self._most_deg = nothing, nothing, nothing
        self._obstacles: Mapping[str, str] = {}

    def note(self, pose: LimpPose) -> None:
        """Extend the ranges by a pose; servos that are held or silent are left out."""
        free = [name not in pose.obstacles for name in self._names]
        here_deg = np.where(free, pose.positions_deg, np.nan)
        self._here_deg, self._obstacles = here_deg, pose.obstacles
        self._least_deg = np.fmin(self._least_deg, here_deg)
        self._most_deg = np.fmax(self._most_deg, here_deg)

    def ends(self) -> dict[str, tuple[float, float]]:
        """Return (least, most) degrees of each joint by name; NaN for a joint never read."""
        ends_deg = zip(self._least_deg.tolist(), self._most_deg.tolist(), strict=True)
        return dict(zip(self._names, ends_deg, strict=True))

    def lines(self) -> list[str]:
        """Return a line of text for each joint: its position and range, or why it has none."""
        return [
            f"{name}: {here:.1f} deg, turned from {least:.1f} to {most:.1f}"
            if math.isfinite(least)
            else f"{name}: {self._obstacles.get(name, _SILENT)}"
            for (name, (least, most)), here in zip(
                self.ends().items(), self._here_deg.tolist(), strict=True
            )
        ]

    def table(self) -> "Table":
        """Return a table of position, range and obstacle of each joint, for the terminal."""
        from rich.table import Table

        table = Table("joint", "now", "least", "most", "", box=None)
        for (name, ends), here in zip(self.ends().items(), self._here_deg.tolist(), strict=True):
            shown = (f"{deg:.1f}" if math.isfinite(deg) else "-" for deg in (here, *ends))
            table.add_row(name, *shown, self._obstacles.get(name, ""))
        return table
