"""What the servos of a bus can do, and the effect of a stop on it; stated in this module only."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Final

#: The word for a servo that has reported that its torque is off.
LIMP: Final = "limp"
#: A servo stays slow for so long after its torque came on; a hobby servo has caught up by then.
SOFT_START_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class BusCapabilities:
    """What the servos of one kind of bus can do; callers test this, not the kind.

    Values that a bus cannot know are NaN (positions, load, heat, voltage), and callers conclude
    nothing from them.

    Attributes
    ----------
    place : servos report their position.
    load, heat, voltage : servos report their load, temperature and supply voltage.
    watchdog : servos stop by themselves when no packet arrives.
    confirmed_limp : servos report themselves that torque is off.
    hold : servos stay at their position while nothing is sent.
    profile : servos limit their own speed.
    soft_start_s : seconds of low speed after torque came on.
    stagger_s : seconds from one servo's torque to the next one's.
    in_memory : there are no servos: nothing is worn, warmed or left stiff, and there is no port.
    memory : servos store settings, by which an exchanged servo is recognised.
    set_up : `setup-servos` can write these settings.
    pulse_rate_hz : of hobby servos, which accept new goals no more often; None: goals are packets.
    released_words : how a servo is described whose torque was switched off.
    """

    place: bool = False
    load: bool = False
    heat: bool = False
    voltage: bool = False
    watchdog: bool = False
    confirmed_limp: bool = False
    hold: bool = False
    profile: bool = False
    soft_start_s: float = 0.0
    stagger_s: float = 0.0
    in_memory: bool = False
    memory: bool = False
    set_up: bool = False
    pulse_rate_hz: float | None = None
    released_words: str = LIMP

    def of(self, _index: int) -> "BusCapabilities":
        """Return what one servo of the face can do: on one bus, the capabilities of all."""
        return self

    def start_s(self, n_servos: int) -> float:
        """Return the seconds from the first servo's torque until all may move at full speed."""
        if self.in_memory:
            return 0.0
        return self.soft_start_s + self.stagger_s * (n_servos - 1)

    def as_dict(self) -> dict[str, object]:
        """Return all capabilities as JSON values, by attribute name."""
        return {each.name: getattr(self, each.name) for each in fields(BusCapabilities)}

    def warnings(self) -> list[str]:
        """Return what a person must know before starting a face: a line for each kind of stop.

        Only the line about a dead computer where servos confirm torque off; empty where they also
        stop by a watchdog, and for servos in memory.
        """
        if self.in_memory or (self.confirmed_limp and self.watchdog):
            return []
        lines = [f"{how}: {what}" for how, what in self.stop_table().items()]
        return lines[-1:] if self.confirmed_limp else lines

    def stop_table(self) -> Mapping[str, str]:
        """Return by kind of stop, such as `stop --limp`, its effect on the servos, in words."""
        confirmed = "confirmed by each servo" if self.confirmed_limp else "which no servo confirms"
        let_go = f"{self.released_words}, {confirmed}"
        where = "where they stand" if self.place else "at the goal sent last"
        if self.in_memory:
            alone = "nothing: they exist in memory only"
        elif self.watchdog:
            alone = "they stop by themselves, and hold" if self.place else self.released_words
        else:
            alone = "they go on to the goal sent last" + (", and hold" if self.hold else "")
        return {
            "stop": f"to neutral; then {let_go}",
            "stop --limp": let_go,
            "stop --freeze": f"held {where}",
            "computer dies, or the plug is pulled": alone,
        }


#: The capabilities of serial servos of every make.
SERIAL_SERVOS: Final = BusCapabilities(
    place=True,
    load=True,
    heat=True,
    voltage=True,
    confirmed_limp=True,
    hold=True,
    profile=True,
    soft_start_s=SOFT_START_S,
    memory=True,
    set_up=True,
)
#: What happens to a face with several buses when one of them is lost; printed at its start.
ONE_LOST: Final = (
    "the port of one bus is lost: the servos of all others are let go at once; the face comes back "
    "when every port is back; frozen serial servos go on holding"
)


@dataclass(frozen=True, slots=True)
class MixedCapabilities(BusCapabilities):
    """Capabilities of a face with several buses: what all servos can do; `of` has one servo's.

    buses: the capabilities of each bus, by its name. bus_of: the name of each servo's bus.
    """

    buses: Mapping[str, BusCapabilities] = field(default_factory=dict)
    bus_of: tuple[str, ...] = ()

    def of(self, index: int) -> BusCapabilities:
        """Return the capabilities of the bus of one servo, by the servo's index."""
        return self.buses[self.bus_of[index]]

    def start_s(self, _n_servos: int) -> float:
        """Return the longest start time of any bus, in s."""
        return max(can.start_s(self.bus_of.count(name)) for name, can in self.buses.items())

    def as_dict(self) -> dict[str, object]:
        """Return for JSON what all servos can do, what each bus can do, and each servo's bus."""
        buses = {name: can.as_dict() for name, can in self.buses.items()}
        return {**BusCapabilities.as_dict(self), "buses": buses, "bus_of": list(self.bus_of)}

    def warnings(self) -> list[str]:
        """Return the warnings of each bus, then a line about the loss of a single bus.

        Without the last line where the servos exist in memory only.
        """
        lines = [f"{name}: {line}" for name, can in self.buses.items() for line in can.warnings()]
        return lines if self.in_memory else [*lines, ONE_LOST]


def mixed_capabilities(
    buses: Mapping[str, BusCapabilities], bus_of: Sequence[str]
) -> MixedCapabilities:
    """Return the capabilities of a face with several buses.

    buses: the capabilities of each bus, by its name. bus_of: the name of each servo's bus.
    """
    # The face has a capability that every bus has, the longest of times, and the lowest of rates.
    cans = list(buses.values())
    common = {
        each.name: all(getattr(can, each.name) for can in cans)
        for each in fields(BusCapabilities)
        if each.type in (bool, "bool")
    }
    rates_hz = [can.pulse_rate_hz for can in cans if can.pulse_rate_hz is not None]
    words = {can.released_words for can in cans}
    return MixedCapabilities(
        **common,
        soft_start_s=max(can.soft_start_s for can in cans),
        stagger_s=max(can.stagger_s for can in cans),
        pulse_rate_hz=min(rates_hz, default=None),
        released_words=words.pop()
        if len(words) == 1
        else "; ".join(f"{name}: {can.released_words}" for name, can in buses.items()),
        buses=buses,
        bus_of=tuple(bus_of),
    )


#: Of servos that are simulated in memory, by a clock alone: they are always cool and rested.
IN_MEMORY: Final = BusCapabilities(
    place=True, load=True, heat=True, voltage=True, confirmed_limp=True, hold=True, in_memory=True
)
