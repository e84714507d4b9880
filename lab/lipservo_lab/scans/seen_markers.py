"""Named points that were seen in scans: painted dots, lipstick, or a tracker's."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lipservo_lab.scans.scan import ScanError
from lipservo_lab.scans.scan_frame import ScanFrame
from lipservo_lab.scans.surface_fit import Markers
from lipservo_lab.scans.template import Template
from lipsync.arrays import Array
from lipsync.markers import FACE_MESH_478, MARKERS_47

_COLUMNS = ("scan", "name", "x", "y", "z")


def read_markers(path: Path, template: Template, frame: ScanFrame) -> Mapping[str, Markers]:
    """By the name of the scan, without its ending.

    A CSV file with the columns scan, name, x, y, z, in units and axes of the scans. A name is that
    of a layout's point, such as `outer_lip_61`, or the number of a landmark. Raises ScanError for a
    file that cannot be read so, and for a name that the template has not.
    """
    row_of = {int(number): row for row, number in enumerate(template.landmarks)}
    known = {str(number): row for number, row in row_of.items()}
    for layout in (MARKERS_47, FACE_MESH_478, template.layout):
        for name, number in zip(layout.names, layout.landmarks, strict=True):
            if number in row_of:
                known[name] = row_of[number]
    seen: dict[str, dict[int, list[float]]] = {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if not set(_COLUMNS) <= set(reader.fieldnames or ()):
                raise ScanError(f"{path}: its first line must name {','.join(_COLUMNS)}")
            for line in reader:
                where = f"{path}, line {reader.line_num}"
                vertex = known.get(str(line["name"]).strip())
                if vertex is None:
                    raise ScanError(
                        f"{where}: the template has no point {line['name']!r}; names are those of "
                        "the layouts, outer_lip_61 for one, or numbers of landmarks"
                    )
                seen.setdefault(str(line["scan"]).strip(), {})[vertex] = _place(line, where)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScanError(f"{path}: cannot be read as CSV: {error}") from error
    return {
        scan: Markers(np.array(list(points)), frame.in_mm(np.array(list(points.values()))))
        for scan, points in seen.items()
    }


def _place(line: Mapping[str, str | None], where: str) -> list[float]:
    try:
        place: Array = np.array([float(line[axis] or "") for axis in "xyz"])
    except (TypeError, ValueError):
        place = np.full(3, np.nan)
    if not np.isfinite(place).all():
        raise ScanError(f"{where}: x, y and z are not three numbers")
    return [float(each) for each in place]
