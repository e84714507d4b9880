"""Servos as mounted in a face: joint degrees to position registers, and identity checks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.bus_kinds import other_kind_at
from firmware_bridge.errors import ServoError
from firmware_bridge.joints import Joint, named
from firmware_bridge.transport import Transport

#: What mends a servo that differs from the YAML.
SETUP: Final = "run `lipservo setup-servos`"
_SILENT: Final = "does not answer; check its power, cable and baud rate"
_DOCTOR: Final = "`lipservo doctor` shows every difference between the servos and the YAML"


class PositionServo(Protocol):
    """The properties of a servo model that are needed to mount it.

    n_positions, center_pulse, pulses_per_deg: of the position registers. current_unit_ma: of the
    register of the current; None: the model does not measure it.
    """

    @property
    def name(self) -> str:
        """The model's name in the YAML."""

    @property
    def n_positions(self) -> int:
        """How many values the position registers have."""

    @property
    def center_pulse(self) -> int:
        """The position register's value where the servo angle is 0."""

    @property
    def pulses_per_deg(self) -> float:
        """Steps of the position registers per degree."""

    @property
    def current_unit_ma(self) -> float | None:
        """Milliamperes per step of the current register; None: the current is not measured."""


Model = TypeVar("Model", bound=PositionServo, covariant=True)
Identity = TypeVar("Identity")


@dataclass(frozen=True)
class MountedServo(Generic[Model]):
    """One servo and the joint it drives. servo angle = sign x (joint angle + zero_offset_deg).

    max_current_ma: the limit of the servo's current; None: no limit.
    Raises ValueError for a current limit on a model that does not measure current.
    """

    joint: Joint
    model: Model
    sign: int = 1
    zero_offset_deg: float = 0.0
    max_current_ma: float | None = None

    def __post_init__(self) -> None:
        if self.max_current_ma is not None and self.model.current_unit_ma is None:
            raise ValueError(
                f"joint {self.joint.name!r}: an {self.model.name} does not measure current; remove "
                "max_current_ma"
            )

    @property
    def current_cap(self) -> int | None:
        """The highest value for the current register, in its unit; None: no limit."""
        unit_ma = self.model.current_unit_ma
        if self.max_current_ma is None or unit_ma is None:
            return None
        return max(1, int(self.max_current_ma / unit_ma))

    def pulse(self, joint_deg: float) -> int:
        """Return the position register's value for a joint angle in degrees."""
        servo_deg = self.sign * (joint_deg + self.zero_offset_deg)
        return round(self.model.center_pulse + servo_deg * self.model.pulses_per_deg)

    def pulse_range(self) -> tuple[int, int]:
        """Return the joint's soft limits as position register values, the smaller first."""
        ends = self.pulse(self.joint.min_deg), self.pulse(self.joint.max_deg)
        return min(ends), max(ends)


class Mounting:
    """Conversion between joint degrees and position register values of all servos of a face.

    Arrays are (n_servos,).
    """

    def __init__(self, servos: Sequence[MountedServo[PositionServo]]) -> None:
        self._scale = np.array([servo.sign * servo.model.pulses_per_deg for servo in servos])
        offset = np.array([servo.zero_offset_deg for servo in servos])
        center = np.array([servo.model.center_pulse for servo in servos])
        self._zero = center + offset * self._scale

    def pulses(self, joint_deg: Array) -> Array:
        """Return the servos' position register values (pulses) for joint angles.

        Parameters
        ----------
        joint_deg : Array
            (n_servos,) degrees.

        Returns
        -------
        Array
            (n_servos,) whole pulses, as floats: what is not finite stays so.
        """
        pulses: Array = np.rint(self._zero + joint_deg * self._scale)
        return pulses

    def joint_deg(self, pulses: Array) -> Array:
        """Return the joint angles for the servos' position register values (pulses).

        Parameters
        ----------
        pulses : Array
            (n_servos,).

        Returns
        -------
        Array
            (n_servos,) degrees; NaN stays NaN.
        """
        joint_deg: Array = (pulses - self._zero) / self._scale
        return joint_deg

    def obstacle(self, index: int, place: int, low: float, high: float) -> str:
        """Return why servo `index` cannot hold the position `place`; empty: it is in low..high.

        place, low, high: values of the position register; `low` and `high` are the limits set in
        the servo itself. The text has joint degrees.
        """
        if low <= place <= high:
            return ""
        here_deg, *ends_deg = (
            float((each - self._zero[index]) / self._scale[index]) for each in (place, low, high)
        )
        return (
            f"stands at {here_deg:.1f} deg, outside its own range; move it into "
            f"{min(ends_deg):.1f}..{max(ends_deg):.1f} deg by hand"
        )


def checked_identities(
    kind: str,
    transport: Transport | None,
    servos: Sequence[MountedServo[Model]],
    found: Sequence[Identity | None],
    mismatches: Callable[[MountedServo[Model], Identity], list[str]],
    *,
    strict: bool,
) -> list[Identity | None]:
    """Return `found`, the identities that servos reported (None: silent), if they can be driven.

    mismatches: returns the differences between a servo and its identity, one text each. strict:
    every servo must answer; otherwise servos may be silent, but neither a critical one nor all.
    kind: the face's kind of bus. transport: an open port; if all servos are silent, servos of other
    kinds are searched for there; None: no search. Raises ServoError that lists all mismatches, or
    names the kind of bus that does answer.
    """
    silent = [servo for servo, each in zip(servos, found, strict=True) if each is None]
    if len(silent) == len(servos) and transport is not None:
        other = other_kind_at(transport, kind)
        if other:
            raise ServoError(other)
    # Silent servos are accepted if not all are silent and none of them is critical.
    bearable = not strict and len(silent) < len(servos)
    bearable = bearable and not any(servo.joint.critical for servo in silent)
    lines = []
    for servo, each in zip(servos, found, strict=True):
        silence = [] if bearable else [_SILENT]
        wrong = silence if each is None else mismatches(servo, each)
        lines += [f"{named(servo.joint)} {why}" for why in wrong]
    if lines:
        raise ServoError("\n".join([*lines, _DOCTOR]))
    return list(found)
