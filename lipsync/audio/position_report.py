"""What a loudspeaker's callback knows of the block that it has just filled."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PositionReport:
    """A block's first sample leaves the loudspeaker at `leaves_s`; after `ends_s` all has left.

    Both on the monotonic clock. position_s, end_position_s: the timeline at these two.
    """

    leaves_s: float
    position_s: float
    ends_s: float
    end_position_s: float

    def at(self, now_s: float) -> tuple[float, float]:
        """(monotonic seconds, timeline seconds that leave then), as far as is known at `now_s`.

        A device that has not asked for more by the time that all has left stands still, and its
        position with it.
        """
        if now_s > self.ends_s:
            return now_s, self.end_position_s
        return self.leaves_s, self.position_s
