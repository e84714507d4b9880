"""How many ticks a bridge has run, and whether they and their targets come in time."""

from dataclasses import dataclass
from typing import Final

#: The time constant of the shares: a stall of a second is nothing, one of two is reported.
_MEMORY_S: Final = 8.0
#: A share that is reported from this on, and until it is below this.
_REPORTED_SHARE, _OVER_SHARE = 0.2, 0.05
_LATE: Final = "the servo loop missed {:.0%} of its last ticks (computer busy, or bus slow?)"
_STALE: Final = "no new motion came from speech in {:.0%} of the last ticks (computer busy?)"


@dataclass(slots=True)
class TickCounts:
    """Counts of ticks since a bridge was made, and shares of late and stale ones lately.

    rate_hz: nominal rate of the ticks. n_late: ticks that were missed. n_stale: ticks of a face
    that is driven, or limp since no targets come, whose target was no longer fresh; the wait for
    the first target after a start does not count. n_armed: how often the face was brought up:
    started, sent targets again after a silence, plugged in again. n_unplugged: how often the port
    was lost. late_share, stale_share: of the ticks of the last seconds. keeps_up: False while one
    of the two is too large.
    """

    rate_hz: float
    n_ticks: int = 0
    n_late: int = 0
    n_stale: int = 0
    n_armed: int = 0
    n_unplugged: int = 0
    late_share: float = 0.0
    stale_share: float = 0.0
    keeps_up: bool = True

    def add(self, late: int, *, is_stale: bool) -> None:
        """Count one tick. late: how many ticks were missed before it. is_stale: as for `n_stale`.

        The shares are exponential averages over ticks, with a time constant of 8 s.
        """
        self.n_ticks += 1
        self.n_late += late
        self.n_stale += is_stale
        weight = 1.0 / (_MEMORY_S * self.rate_hz)
        kept = 1.0 - weight
        # Every missed tick counts as a late one, then this tick as one in time.
        if late:
            self.late_share = 1.0 - (1.0 - self.late_share) * kept**late
        self.late_share *= kept
        self.stale_share = kept * self.stale_share + weight * is_stale
        # Hysteresis: False from a share of 20 % on, until both are below 5 %.
        worst = max(self.late_share, self.stale_share)
        self.keeps_up = worst < (_REPORTED_SHARE if self.keeps_up else _OVER_SHARE)

    def delays(self) -> tuple[str, ...]:
        """Return a line for what comes late; empty while the face keeps up."""
        shares = () if self.keeps_up else ((self.late_share, _LATE), (self.stale_share, _STALE))
        return tuple(line.format(share) for share, line in shares if share >= _OVER_SHARE)
