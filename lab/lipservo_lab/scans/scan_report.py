"""What became of scans and takes, in figures and in words."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True, slots=True)
class ScanReport:
    """One scan.

    left_out: why nothing was made of it. error_mm, p95_mm: distance between mesh and scan along the
    normal where they were matched, median and 95th percentile; it does not tell sliding along the
    surface. matched: share of the mesh that found its surface. markers: how many were used.
    """

    take: str
    scan: str
    left_out: str | None = None
    error_mm: float | None = None
    p95_mm: float | None = None
    matched: float | None = None
    markers: int = 0

    def as_json(self) -> dict[str, object]:
        """By name."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class TakeReport:
    """One take. phonemes: `labels`, `text` or `recognised`; None without sound."""

    take: str
    scans: int
    left_out: str | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    phonemes: str | None = None

    def as_json(self) -> dict[str, object]:
        """By name."""
        return asdict(self)
