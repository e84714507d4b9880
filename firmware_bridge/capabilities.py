"""What the servos of a bus can do, and what a stop can do on it: said once, asked everywhere."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

#: What a servo is called that has reported that its torque is off.
LIMP: Final = "limp"


@dataclass(frozen=True, slots=True)
class BusCapabilities:
    """What the servos of one kind of bus can do; whoever needs it asks for this, not for the kind.

    What a bus cannot know it reports as NaN (places, load, heat, voltage), and nothing that follows
    from it is claimed for it.

    Attributes
    ----------
    place : servos report where they stand.
    load, heat, voltage : they report how hard they pull, how warm they are, what supply they have.
    watchdog : they stop by themselves when they hear nothing.
    confirmed_limp : they report themselves that torque is off.
    hold : they stay where they are while nothing is sent.
    profile : they bound their own speed.
    soft_start_s : they are slow for so long after torque came on.
    in_memory : there are no servos: nothing is worn, warmed or left stiff, and there is no port.
    memory : they keep settings of their own, by which one that was exchanged is known.
    set_up : `setup-servos` can write these settings.
    pulse_rate_hz : of hobby servos, which take a new goal no more often; None: goals are packets.
    released_words : what is true of a servo that was let go.

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
    in_memory: bool = False
    memory: bool = False
    set_up: bool = False
    pulse_rate_hz: float | None = None
    released_words: str = LIMP

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {name: getattr(self, name) for name in self.__slots__}

    def warnings(self) -> list[str]:
        """What a person who starts a face must know before: a line for each way to stop it.

        None for a stop that is confirmed, for servos that stop by themselves, and for none at all.
        """
        if self.in_memory or (self.confirmed_limp and self.watchdog):
            return []
        lines = [f"{how}: {what}" for how, what in self.stop_table().items()]
        return lines[-1:] if self.confirmed_limp else lines

    def stop_table(self) -> Mapping[str, str]:
        """What each way to stop does to the servos, by the name of the way; docs/hardware.md."""
        let_go = f"{self.released_words}, " + (
            "confirmed by each servo" if self.confirmed_limp else "which no servo confirms"
        )
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


#: Of servos that are simulated in memory, by a clock alone: they are always cool and rested.
IN_MEMORY: Final = BusCapabilities(
    place=True, load=True, heat=True, voltage=True, confirmed_limp=True, hold=True, in_memory=True
)
