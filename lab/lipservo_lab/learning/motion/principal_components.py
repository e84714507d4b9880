"""Principal components of frames that do not all count alike."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from lipsync.arrays import Array

#: Of more values the covariance is not formed: dense scans have 20,000.
_MOST_FOR_COVARIANCE = 1_500


@dataclass(frozen=True, slots=True)
class PrincipalComponents:
    """mean (n_values,); basis (n_components, n_values), rows orthonormal, the largest first.

    variance_held: the share of the variance that they hold.
    """

    mean: Array
    basis: Array
    variance_held: float

    def coefficients(self, frames: Array) -> Array:
        """(n_frames, n_values) -> (n_frames, n_components)."""
        return np.asarray(frames @ self.basis.T - self.mean @ self.basis.T)


def principal_components(frames: Array, weights: Array, n_components: int) -> PrincipalComponents:
    """The eigenvectors of the weighted covariance.

    frames: (n_frames, n_values); weights: (n_frames,), a frame of weight 2 counts as two. The
    largest number of each component is positive, so that the same frames give the same signs.
    """
    total = weights.sum()
    mean = (frames * weights[:, None]).sum(axis=0) / total
    if frames.shape[1] > _MOST_FOR_COVARIANCE:
        return _leading(frames - mean, mean, weights, n_components)
    weighted = frames * np.sqrt(weights)[:, None]
    scatter = weighted.T @ weighted - total * np.outer(mean, mean)
    variances, vectors = np.linalg.eigh(scatter)
    variances, basis = np.maximum(variances[::-1], 0.0), vectors.T[::-1]
    held = float(variances[:n_components].sum() / variances.sum())
    return PrincipalComponents(mean, _signed(basis)[:n_components].copy(), held)


def _leading(centred: Array, mean: Array, weights: Array, n_components: int) -> PrincipalComponents:
    """The same eigenvectors by Lanczos' method, from the frames alone."""
    n_values = centred.shape[1]
    operator = LinearOperator(
        (n_values, n_values), matvec=lambda v: centred.T @ (weights * (centred @ v.ravel()))
    )
    variances, vectors = eigsh(operator, k=n_components, v0=np.ones(n_values))
    variances, basis = np.maximum(variances[::-1], 0.0), vectors.T[::-1]
    everything = float((weights * np.einsum("ij,ij->i", centred, centred)).sum())
    return PrincipalComponents(mean, _signed(basis), float(variances.sum()) / everything)


def _signed(basis: Array) -> Array:
    largest = np.take_along_axis(basis, np.abs(basis).argmax(axis=1)[:, None], axis=1)
    return np.ascontiguousarray(basis * np.sign(largest))
