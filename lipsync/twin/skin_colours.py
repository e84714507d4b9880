"""How the skin is painted: a colour a vertex, from where it lies. Chosen, not measured."""

import numpy as np
from scipy.spatial import cKDTree

from lipsync.arrays import Array
from lipsync.face_mesh import OUTER_LIP
from lipsync.twin.landmarks import LEFT_BROW, LEFT_EYE, N_UPPER_LID, RIGHT_BROW, RIGHT_EYE
from lipsync.twin.mean_face import MeanFace

_SKIN = (0.91, 0.74, 0.65)
_LIPS = (0.80, 0.50, 0.48)
_CHEEKS = (0.93, 0.66, 0.58)
_BROWS = (0.36, 0.26, 0.21)
_LASHES = (0.24, 0.16, 0.13)
#: The back of the head is a robot's: that it has no hair and no ears does not surprise then.
_ROBOT = (0.55, 0.60, 0.66)
_CHEEK_MIDDLES, _CHEEK_RADIUS_MM = (205, 425), 22.0
_LIP_EDGE_MM, _LASH_EDGE_MM = 3.0, 1.3
_BROW_HALF_WIDTH_MM = 3.6
#: Nothing is painted farther from its line.
_FAR_MM = 8.0
#: Height of two places on the seam between skin and robot, and how many rings behind the rim.
_SEAM_MM, _SEAM_RINGS = (-115.0, -70.0, 30.0), (4.5, 1.6, 0.9)


def skin_colours(mean: MeanFace) -> Array:
    """(n, 3), 0 to 1, sRGB."""
    places = mean.vertices_mm
    colours = np.broadcast_to(np.array(_SKIN), places.shape)
    layers = (
        (_cheeks(places), _CHEEKS),
        (_lips(mean), _LIPS),
        (0.85 * _brows(places), _BROWS),
        (0.8 * _lashes(places), _LASHES),
        (_robot(mean), _ROBOT),
    )
    for amount, colour in layers:
        colours = (1 - amount[:, None]) * colours + amount[:, None] * np.array(colour)
    return np.asarray(colours, dtype=np.float64)


def _cheeks(places: Array) -> Array:
    away = [np.linalg.norm(places - places[each], axis=1) for each in _CHEEK_MIDDLES]
    return 0.5 * np.asarray(np.exp(-((np.min(away, axis=0) / _CHEEK_RADIUS_MM) ** 2)))


def _lips(mean: MeanFace) -> Array:
    """1 within the outer line of the lips as the viewer sees it, with a soft edge."""
    outline = mean.vertices_mm[list(OUTER_LIP), :2]
    closed = np.vstack([outline, outline[:1]])
    flat = mean.vertices_mm[:, :2]
    away, _ = cKDTree(_line(closed, 6)).query(flat, distance_upper_bound=_FAR_MM)
    inside = _inside(flat, outline) * (mean.behind == 0.0)
    edge = np.where(inside > 0, 1.0, -1.0) * np.minimum(away, _FAR_MM) / _LIP_EDGE_MM
    return np.asarray(np.clip(0.35 + edge, 0.0, 1.0), dtype=np.float64)


def _brows(places: Array) -> Array:
    """Along the middle of each eyebrow, with soft edges, thinner at both ends."""
    amount = np.zeros(len(places))
    for lower, upper in (RIGHT_BROW, LEFT_BROW):
        line = _line((places[list(lower)] + places[list(upper)]) / 2, 10)
        share = np.linspace(0, 1, len(line))
        width = _BROW_HALF_WIDTH_MM * np.interp(share, (0, 0.5, 0.85, 1), (0.3, 0.9, 1.0, 0.6))
        away, nearest = cKDTree(line).query(places, distance_upper_bound=_FAR_MM)
        near = np.isfinite(away)
        amount[near] = np.maximum(amount[near], 1.4 - away[near] / width[nearest[near]])
    return np.clip(amount, 0.0, 1.0)


def _lashes(places: Array) -> Array:
    """Along the edge of the upper lids."""
    lines = [_line(places[list(each[:N_UPPER_LID])], 8)[8:] for each in (RIGHT_EYE, LEFT_EYE)]
    away, _ = cKDTree(np.vstack(lines)).query(places, distance_upper_bound=_FAR_MM)
    return np.asarray(np.clip(1.0 - away / _LASH_EDGE_MM, 0.0, 1.0), dtype=np.float64)


def _robot(mean: MeanFace) -> Array:
    seam = np.interp(mean.vertices_mm[:, 1], _SEAM_MM, _SEAM_RINGS)
    return np.asarray(np.clip(0.5 + 2.5 * (mean.behind - seam), 0.0, 1.0))


def _line(corners: Array, steps: int) -> Array:
    """Points along a polygon line, `steps` from one corner to the next."""
    at = np.linspace(0, len(corners) - 1, steps * (len(corners) - 1) + 1)
    known = np.arange(len(corners))
    return np.column_stack([np.interp(at, known, column) for column in corners.T])


def _inside(points: Array, polygon: Array) -> Array:
    """1 for points (n, 2) within a polygon (m, 2): an odd number of edges to their right."""
    start, end = polygon, np.roll(polygon, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    spans = (start[:, 1] > y) != (end[:, 1] > y)
    rise = np.where(start[:, 1] == end[:, 1], 1.0, end[:, 1] - start[:, 1])
    crossing = start[:, 0] + (y - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    return np.asarray((spans & (x < crossing)).sum(axis=1) % 2, dtype=np.float64)
