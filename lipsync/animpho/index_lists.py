"""Sparse 0/1 tables: which AnimPhos follow one, which belong to a phoneme."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class IndexLists:
    """A list of indices for each of n rows, stored end to end (the 0/1 tables of the paper).

    starts: (n + 1,); indices: (starts[-1],), ascending within a row.
    """

    starts: Indices
    indices: Indices

    @classmethod
    def from_pairs(cls, rows: Indices, columns: Indices, n_rows: int) -> "IndexLists":
        """From the table's non-zero places, given in any order and any number of times."""
        pairs = np.unique(np.stack([rows, columns], axis=1), axis=0).astype(np.int64)
        starts = np.searchsorted(pairs[:, 0], np.arange(n_rows + 1)).astype(np.int64)
        return cls(starts, np.ascontiguousarray(pairs[:, 1]))

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, row: int) -> Indices:
        return self.indices[self.starts[row] : self.starts[row + 1]]

    def transposed(self, n_rows: int) -> "IndexLists":
        """The same table read by columns; n_rows is the number of columns here."""
        return IndexLists.from_pairs(self.indices, self.rows(), n_rows)

    def rows(self) -> Indices:
        """The row of every stored index."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))
