"""Register takes of scans: each becomes motion of one mesh, with a report for each scan and take.

Named points may have been marked in scans: painted dots, lipstick, or a tracker's.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipservo.terminal.output import Advance
from lipservo_lab.scans.head_alignment import Template, check_face, shipped_template
from lipservo_lab.scans.scan import (
    Scan,
    ScanError,
    ScanFrame,
    ScanFrameError,
    check_unit,
    read_scan,
)
from lipservo_lab.scans.surface_fit import Markers, RegisteredScan, Registration, worn_template
from lipservo_lab.scans.takes import Take
from lipsync.arrays import Array
from lipsync.markers import FACE_MESH_478, MARKERS_47


@dataclass(frozen=True, slots=True)
class ScanReport:
    """What became of one scan.

    left_out: why it is not used; None: it is. error_mm, p95_mm: distance between mesh and scan
    along the normal where they match, median and 95th percentile; it does not show sliding along
    the surface. matched: share of the mesh that has its surface in the scan. markers: how many were
    used.
    """

    take: str
    scan: str
    left_out: str | None = None
    error_mm: float | None = None
    p95_mm: float | None = None
    matched: float | None = None
    markers: int = 0

    def as_json(self) -> dict[str, object]:
        """Return the fields by name."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class TakeReport:
    """What became of one take.

    left_out: why it is not used; None: it is. phonemes: `labels`, `text` or `recognised`; None
    without sound.
    """

    take: str
    scans: int
    left_out: str | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    phonemes: str | None = None

    def as_json(self) -> dict[str, object]:
        """Return the fields by name."""
        return asdict(self)


_COLUMNS = ("scan", "name", "x", "y", "z")


def read_markers(path: Path, template: Template, frame: ScanFrame) -> Mapping[str, Markers]:
    """Read named points of scans, by the name of the scan without its ending.

    A CSV file with the columns scan, name, x, y, z, in units and axes of the scans. A name is that
    of a layout's point, such as `outer_lip_61`, or the number of a landmark. Raises ScanError for a
    file that cannot be read so, and for a name that the template lacks.
    """
    row_of = {int(number): row for row, number in enumerate(template.landmarks)}
    vertex_of = {str(number): row for number, row in row_of.items()}
    for layout in (MARKERS_47, FACE_MESH_478, template.layout):
        for name, number in zip(layout.names, layout.landmarks, strict=True):
            if number in row_of:
                vertex_of[name] = row_of[number]
    points_of: dict[str, dict[int, list[float]]] = {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if not set(_COLUMNS) <= set(reader.fieldnames or ()):
                raise ScanError(f"{path}: its first line must name {','.join(_COLUMNS)}")
            for line in reader:
                where = f"{path}, line {reader.line_num}"
                vertex = vertex_of.get(str(line["name"]).strip())
                if vertex is None:
                    raise ScanError(
                        f"{where}: the template has no point {line['name']!r}; names are those of "
                        "the layouts, outer_lip_61 for one, or numbers of landmarks"
                    )
                points_of.setdefault(str(line["scan"]).strip(), {})[vertex] = _point(line, where)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScanError(f"{path}: cannot be read as CSV: {error}") from error
    return {
        scan: Markers(np.array(list(points)), frame.in_mm(np.array(list(points.values()))))
        for scan, points in points_of.items()
    }


def _point(line: Mapping[str, str | None], where: str) -> list[float]:
    """Return x, y and z of a line of a CSV file; raise ScanError unless all are finite numbers."""
    try:
        point: Array = np.array([float(line[axis] or "") for axis in "xyz"])
    except (TypeError, ValueError):
        point = np.full(3, np.nan)
    if not np.isfinite(point).all():
        raise ScanError(f"{where}: x, y and z are not three numbers")
    return [float(coordinate) for coordinate in point]


#: Missing scans are interpolated for at most this long.
_LONGEST_HOLE_S = 0.1
#: Scans that are kept for the picture sheet, evenly spread over all.
_SAMPLES = 24


@dataclass(frozen=True, slots=True)
class RegisteredTake:
    """A take as motion of the mesh: points_mm (n_scans, n_vertices, 3), head motion removed."""

    take: Take
    points_mm: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class SampleScan:
    """A scan for the picture sheet.

    errors_mm: (n_vertices,), NaN where the scan has no surface.
    """

    report: ScanReport
    points_mm: Array
    errors_mm: Array


@dataclass(frozen=True)
class ScanImport:
    """Registers all takes; `takes` and `scans` collect the reports of those done.

    template: in the shape of the person. neutral: the scan that its shape is from. given: the takes
    to register. markers: by take and scan. samples: for the picture sheet.
    """

    template: Template
    neutral: Path
    rate_hz: float
    frame: ScanFrame
    given: tuple[Take, ...]
    markers: Mapping[str, Mapping[str, Markers]]
    takes: list[TakeReport] = field(default_factory=list)
    scans: list[ScanReport] = field(default_factory=list)
    samples: list[SampleScan] = field(default_factory=list)

    def registered(self, advance: Advance) -> Iterator[RegisteredTake]:
        """Register all takes; yield each take that can be used as soon as it is done."""
        n_all = sum(len(take.scans) for take in self.given)
        step = max(1, n_all // _SAMPLES)
        registration = Registration(self.template)
        for take in self.given:
            registration.begin()
            found: list[RegisteredScan | None] = []
            for path in take.scans:
                markers = self.markers.get(take.name, {}).get(path.stem)
                scan, report = _register(registration, take, path, self.frame, markers)
                found.append(scan)
                self.scans.append(report)
                if scan is not None and (len(self.scans) - 1) % step == 0:
                    self.samples.append(_sample(scan, report))
                advance("registering", len(self.scans), n_all)
            joined, of_take = _join_scans(take, found, self.rate_hz)
            self.takes.append(of_take)
            if joined is not None:
                yield joined

    def refuse_nothing(self) -> None:
        """Raise ScanError, with the first reasons, if no take could be used."""
        if any(report.left_out is None for report in self.takes):
            return
        scans = [f"{r.take}/{r.scan}: {r.left_out}" for r in self.scans if r.left_out]
        takes = [f"{r.take}: {r.left_out}" for r in self.takes if r.left_out]
        names = [*scans[:2], *takes[:1]]
        raise ScanError(f"nothing usable: {'; '.join(names)}")


def begin_import(
    takes: Sequence[Take],
    frame: ScanFrame,
    rate_hz: float,
    neutral: Path | None = None,
    advance: Advance = lambda *_: None,
) -> ScanImport:
    """Give the template the shape of the person, and read the markers.

    neutral: a scan of the face at rest; None: the first scan that can be read. Raises ScanError and
    ScanFrameError for scans of another size, along other axes, mirrored, or of no face, and for
    markers that the template lacks.
    """
    template = shipped_template()
    markers = {
        take.name: read_markers(take.markers, template, frame)
        for take in takes
        if take.markers is not None
    }
    for take in takes:
        unknown = sorted(set(markers.get(take.name, ())) - {path.stem for path in take.scans})
        if unknown:
            raise ScanError(f"{take.markers}: take {take.name} has no scan {unknown[0]!r}")
    path, scan = _neutral(takes, frame, neutral)
    check_unit(scan.points_mm, frame.unit, str(path))
    check_face(template.vertices_mm, scan, frame.axes, str(path))
    advance("finding the face", 0, 1)
    neutral_markers = next((m[path.stem] for m in markers.values() if path.stem in m), None)
    try:
        fitted = worn_template(template, scan, neutral_markers)
    except ScanError as error:
        raise ScanError(f"{path}: {error}; give another neutral scan (--template)") from error
    advance("finding the face", 1, 1)
    return ScanImport(fitted, path, rate_hz, frame, tuple(takes), markers)


def _neutral(takes: Sequence[Take], frame: ScanFrame, neutral: Path | None) -> tuple[Path, Scan]:
    """Return the given neutral scan, or else the first scan of all takes that can be read.

    Raises ScanError if none can be read.
    """
    if neutral is not None:
        return neutral, read_scan(neutral, frame)
    first: ScanError | None = None
    for take in takes:
        for path in take.scans:
            try:
                return path, read_scan(path, frame)
            except ScanError as error:
                first = first or error
    raise ScanError(f"no scan can be read: {first}")


def _register(
    registration: Registration,
    take: Take,
    path: Path,
    frame: ScanFrame,
    markers: Markers | None,
) -> tuple[RegisteredScan | None, ScanReport]:
    """Register one scan; return it with its report, or None with a report that says why not."""
    report = ScanReport(
        take.name, path.stem, markers=0 if markers is None else len(markers.seen_mm)
    )
    try:
        scan = read_scan(path, frame)
        check_unit(scan.points_mm, frame.unit, str(path))
        registered = registration.register(scan, markers)
    except (ScanError, ScanFrameError) as error:
        return None, replace(report, left_out=str(error).removeprefix(f"{path}: "))
    errors = registered.errors_mm
    return registered, replace(
        report,
        error_mm=round(float(np.median(errors)), 3),
        p95_mm=round(float(np.percentile(errors, 95)), 3),
        matched=round(registered.matched, 3),
    )


def _join_scans(
    take: Take, found: Sequence[RegisteredScan | None], rate_hz: float
) -> tuple[RegisteredTake | None, TakeReport]:
    """Join a take's scans into one array, with short gaps interpolated; return it and a report.

    found: None for a scan that was left out. The result is None for a take with fewer than two
    scans, or a gap longer than `_LONGEST_HOLE_S`.
    """
    report = TakeReport(take.name, len(found), seconds=round(len(found) / rate_hz, 3))
    there = np.array([scan is not None for scan in found])
    if there.sum() < 2:
        reason = f"a face was found in only {there.sum()} of {len(found)} scans"
        return None, replace(report, left_out=reason)
    gaps = [len(list(group)) for is_there, group in groupby(there.tolist()) if not is_there]
    if gaps and max(gaps) / rate_hz > _LONGEST_HOLE_S + 1e-9:
        reason = f"no face in {max(gaps)} scans in a row, {max(gaps) / rate_hz:.2f} s"
        return None, replace(report, left_out=reason)
    present = np.flatnonzero(there)
    seen = np.array([scan.points_mm for scan in found if scan is not None], dtype=np.float32)
    # For each scan the nearest known ones: at or after it, and before it; itself if it is known.
    after = np.clip(np.searchsorted(present, np.arange(len(found))), 0, len(present) - 1)
    before = np.clip(after - 1, 0, None)
    before = np.where(present[after] <= np.arange(len(found)), after, before)
    length = np.maximum(present[after] - present[before], 1)
    share = np.clip((np.arange(len(found)) - present[before]) / length, 0.0, 1.0)
    points = seen[before] + share[:, None, None].astype(np.float32) * (seen[after] - seen[before])
    notes = (f"{sum(gaps)} scans bridged",) if gaps else ()
    return RegisteredTake(take, points.astype(np.float32)), replace(report, notes=notes)


def _sample(scan: RegisteredScan, report: ScanReport) -> SampleScan:
    errors = np.where(scan.fit.matched, np.abs(scan.fit.off_mm), np.nan)
    return SampleScan(report, scan.points_mm, errors)
