"""A jaw that a servo turns by a crank and a rod: angle of the jaw by angle of the horn."""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array


@dataclass(frozen=True, slots=True)
class FourBar:
    """Lengths in mm: crank (the servo's horn), rod, rocker (the jaw's lever), ground between.

    start_deg: the crank's angle to the ground where the servo is at 0.
    """

    crank_mm: float
    rod_mm: float
    rocker_mm: float
    ground_mm: float
    start_deg: float

    def jaw_deg(self, servo_deg: Array) -> Array:
        """How far the jaw is turned from where it is at 0 (Freudenstein 1955, equation 1)."""
        return np.asarray(self._rocker_deg(servo_deg) - self._rocker_deg(np.zeros(1)))

    def can_turn(self, servo_deg: Array) -> bool:
        """Whether rod and rocker reach the crank's end at all these angles and those between."""
        most, least = float(servo_deg.max()), float(servo_deg.min())
        between = np.linspace(least, most, max(2, round(most - least)))
        reach = self._reach_mm(between)[2]
        longest, shortest = self.rocker_mm + self.rod_mm, abs(self.rocker_mm - self.rod_mm)
        turned = np.diff(self._rocker_deg(between))
        return bool((reach < longest).all() and (reach > shortest).all() and (turned > 0.0).all())

    def _rocker_deg(self, servo_deg: Array) -> Array:
        x, y, reach = self._reach_mm(servo_deg)
        # The triangle of rod, rocker and the line from the crank's end to the rocker's axis.
        cosine = (self.rocker_mm**2 + reach**2 - self.rod_mm**2) / (2 * self.rocker_mm * reach)
        inner = np.arccos(np.clip(cosine, -1.0, 1.0))
        return np.asarray(np.rad2deg(np.arctan2(-y, -x) - inner))

    def _reach_mm(self, servo_deg: Array) -> tuple[Array, Array, Array]:
        """From the rocker's axis to the crank's end: across, along, and how far."""
        crank = np.deg2rad(self.start_deg + servo_deg)
        x, y = self.ground_mm - self.crank_mm * np.cos(crank), -self.crank_mm * np.sin(crank)
        return x, y, np.hypot(x, y)
