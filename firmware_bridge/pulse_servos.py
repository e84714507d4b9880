"""Settings of hobby servos, and conversion between joint degrees and pulse widths.

Shared by every bus that sends pulses: `firmware_bridge.pulse_bus` drives them.
"""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Final, Self

import numpy as np
from pydantic import AfterValidator, model_validator

from firmware_bridge.bus import Array
from firmware_bridge.bus_settings import BusServo, Strict, within
from firmware_bridge.joints import JointPulse

#: No hobby servo takes pulses outside of this; most are meant for 1000 to 2000 us.
SHORTEST_US: Final = 400.0
LONGEST_US: Final = 2600.0

PulseWidth = Annotated[float, within(SHORTEST_US, LONGEST_US)]


def _check_us_per_deg(value: float) -> float:
    if not 1.0 <= abs(value) <= 100.0:
        raise ValueError(
            f"{value:g} us per deg is outside 1..100 and -100..-1; most servos have about 11, or "
            "-11 to reverse the joint"
        )
    return value


class _Channel(Strict):
    """The field `channel`, in a class of its own so that it is first in a servo's entry."""

    channel: Annotated[int, within(0, 255)]


class PulseServo(BusServo, _Channel):
    """A hobby servo in a face's YAML: pulse = neutral_us + us_per_deg x joint angle.

    The pulse stays within min_us..max_us. us_per_deg: negative where a longer pulse makes the joint
    angle smaller.
    """

    address_key: ClassVar[str] = "channel"

    us_per_deg: Annotated[float, AfterValidator(_check_us_per_deg)]
    neutral_us: PulseWidth = 1500.0
    min_us: PulseWidth = 1000.0
    max_us: PulseWidth = 2000.0

    @property
    def pulse(self) -> JointPulse:
        """Neutral pulse, us per degree and pulse range of the servo's joint."""
        return JointPulse(self.neutral_us, self.us_per_deg, self.min_us, self.max_us)

    @model_validator(mode="after")
    def _its_pulses_reach(self) -> Self:
        """Raise ValueError where a limit of the joint needs a pulse outside min_us..max_us.

        Also for a sign or zero_offset_deg, which hobby servos do not have.
        """
        if self.sign != 1 or self.zero_offset_deg != 0.0:
            raise ValueError(
                "hobby servos have no sign and zero_offset_deg; a negative us_per_deg reverses "
                "the joint, and neutral_us moves its zero"
            )
        for name, angle in (("min_deg", self.min_deg), ("max_deg", self.max_deg)):
            pulse_us = self.neutral_us + self.us_per_deg * angle
            if not self.min_us <= pulse_us <= self.max_us:
                raise ValueError(
                    f"{name} {angle:g} deg needs a pulse of {pulse_us:g} us, outside "
                    f"min_us..max_us ({self.min_us:g}..{self.max_us:g} us)"
                )
        return self


class PulseScale:
    """Conversion between the joint angles of a face and pulse widths; arrays are (n_servos,)."""

    def __init__(self, servos: Sequence[PulseServo]) -> None:
        self.us_per_deg: Array = np.array([each.us_per_deg for each in servos])
        self.neutral_us: Array = np.array([each.neutral_us for each in servos])
        self.min_us = np.array([each.min_us for each in servos])
        self.max_us = np.array([each.max_us for each in servos])
        #: As far as pulses go while a person finds the limits, (n_servos, 2).
        self.reach_us = np.array([each.pulse.reach_us for each in servos])
        self.max_us_s = np.abs(self.us_per_deg) * [each.max_speed_deg_s for each in servos]

    def pulses_us(self, joints_deg: Array) -> Array:
        """Return the pulse widths for joint angles, not limited to min_us..max_us.

        Parameters
        ----------
        joints_deg : Array
            (n_servos,) degrees.

        Returns
        -------
        Array
            (n_servos,) us.
        """
        return joints_deg * self.us_per_deg + self.neutral_us

    def joints_deg(self, pulses_us: Array) -> Array:
        """Return the joint angles that pulse widths move the servos to.

        Parameters
        ----------
        pulses_us : Array
            (n_servos,) us.

        Returns
        -------
        Array
            (n_servos,) degrees.
        """
        return (pulses_us - self.neutral_us) / self.us_per_deg
