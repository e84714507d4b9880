"""Rasterisation of triangles by spans of rows, in NumPy: which pixels a flat mesh covers.

A pixel belongs to a triangle if its middle lies inside; of several triangles the last one counts.
"""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array, Array32, Indices

#: Smaller triangles than this cover no pixel's middle worth drawing, square pixels.
_LEAST_AREA_PX2 = 1e-6


@dataclass(frozen=True, slots=True)
class Covered:
    """Pixels that triangles cover, in drawing order.

    rows, columns (n,): of each pixel. triangle (n,): index of the triangle that covers it.
    """

    rows: Indices
    columns: Indices
    triangle: Indices

    def interpolated(self, corners_px: Array, values: Array) -> Array32:
        """Interpolate the values at the triangles' corners linearly, at each covered pixel.

        In each triangle a value is level + slope_x x + slope_y y.

        Parameters
        ----------
        corners_px : Array
            (m, 3, 2) pixels.
        values : Array
            (m, 3, k) values of m triangles.

        Returns
        -------
        Array32
            (k, n), n pixels.
        """
        x, y = corners_px[..., 0], corners_px[..., 1]
        sides = np.stack([x[:, 1:] - x[:, :1], y[:, 1:] - y[:, :1]], axis=-1)
        rises = values[:, 1:] - values[:, :1]
        # A triangle without area covers no pixel; its slopes are never asked for.
        flat = np.abs(np.linalg.det(sides)) <= _LEAST_AREA_PX2
        slopes = np.linalg.solve(np.where(flat[:, None, None], np.eye(2), sides), rises)
        level = values[:, 0] - (x[:, :1] * slopes[:, 0] + y[:, :1] * slopes[:, 1])
        columns, rows = self.columns.astype(np.float32), self.rows.astype(np.float32)
        interpolated = np.empty((values.shape[2], len(columns)), dtype=np.float32)
        # Each of the k values at all pixels, in place, so that little memory is used.
        for k, values_k in enumerate(interpolated):
            np.take(slopes[:, 0, k].astype(np.float32), self.triangle, out=values_k)
            values_k *= columns
            values_k += np.take(slopes[:, 1, k].astype(np.float32), self.triangle) * rows
            values_k += np.take(level[:, k].astype(np.float32), self.triangle)
        return interpolated


def covered(corners_px: Array, height: int, width: int) -> Covered:
    """Return the pixels that triangles cover, x right, y down, a pixel's middle at whole numbers.

    Pixels outside the picture are left out; so are triangles without area.

    Parameters
    ----------
    corners_px : Array
        (n, 3, 2).
    height,width : int
        Pixels.

    Returns
    -------
    Covered
        Row, column and triangle of each pixel.
    """
    x, y = corners_px[..., 0], corners_px[..., 1]
    first = np.clip(np.ceil(y.min(axis=1)), 0, height).astype(np.int64)
    last = np.clip(np.floor(y.max(axis=1)), -1, height - 1).astype(np.int64)
    # Twice the area, signed.
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    # A span is a row of a triangle: first all spans, then the pixels of each.
    n_rows = np.where(np.abs(area) > _LEAST_AREA_PX2, np.maximum(last - first + 1, 0), 0)
    span_triangle, span_row = _expanded(n_rows, first)
    left, right = _span_ends(x, y, span_triangle, span_row.astype(np.float64))
    begin = np.clip(np.ceil(left), 0, width).astype(np.int64)
    end = np.clip(np.floor(right), -1, width - 1).astype(np.int64)
    of_pixel, column = _expanded(np.maximum(end - begin + 1, 0), begin)
    return Covered(span_row[of_pixel], column, span_triangle[of_pixel])


def _expanded(counts: Indices, begin: Indices) -> tuple[Indices, Indices]:
    """Return each index i repeated `counts[i]` times, and beside it begin[i], begin[i] + 1, ..."""
    index = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts - begin
    return index, np.arange(len(index)) - np.repeat(before, counts)


def _span_ends(x: Array, y: Array, of_span: Indices, row: Array) -> tuple[Array, Array]:
    """Return the x at which rows (n,) enter and leave their triangles; 0 and -1 if they do not.

    x, y (m, 3): corners of the triangles; of_span (n,): the triangle of each row.
    """
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        # Where the rows cross this edge; a level edge is left to the two others.
        height = y[:, b] - y[:, a]
        is_level = np.abs(height) < 1e-12
        slope = (x[:, b] - x[:, a]) / np.where(is_level, 1.0, height)
        top = np.where(is_level, np.inf, np.minimum(y[:, a], y[:, b]))
        bottom = np.maximum(y[:, a], y[:, b])
        crossing_x = (x[:, a] - slope * y[:, a])[of_span] + slope[of_span] * row
        crosses = (row >= top[of_span]) & (row <= bottom[of_span])
        np.minimum(left, crossing_x, out=left, where=crosses)
        np.maximum(right, crossing_x, out=right, where=crosses)
    right[~np.isfinite(left)] = -1.0
    left[~np.isfinite(left)] = 0.0
    return left, right
