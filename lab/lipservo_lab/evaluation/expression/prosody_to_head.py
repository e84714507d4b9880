"""How a head's motion goes with the voice: how much later, and how closely."""

from typing import Final

import numpy as np

from lipservo_lab.evaluation.expression.shown_expression import ShownExpression
from lipsync.arrays import Array
from lipsync.expression.cue import CUE_PERIOD_S

#: Lags looked through, either way.
_MOST_LAG_S: Final = 0.5
#: Other places of the same voice that the head is compared with, at least so far off.
_N_SHUFFLED, _LEAST_SHIFT_S = 20, 5.0


def lag_ms(shown: ShownExpression) -> float:
    """By how much head pitch velocity follows loudness where |cross-correlation| is greatest.

    Both over speech only, at cue times; positive: the head is later.
    """
    loudness = _centred(np.where(shown.is_speaking, shown.loudness_z, 0.0))
    velocity = _centred(_velocity(shown.column("neck_pitch_deg")))
    most = round(_MOST_LAG_S / CUE_PERIOD_S)
    inner = slice(most, len(loudness) - most)
    lags = np.arange(-most, most + 1)
    strengths = [
        abs(float(loudness[inner] @ velocity[most + lag : len(velocity) - most + lag]))
        for lag in lags
    ]
    return float(lags[int(np.argmax(strengths))]) * CUE_PERIOD_S * 1e3


def canonical_r(shown: ShownExpression, lag_s: float = 0.0) -> float:
    """First canonical correlation of prosody and head, over speech.

    Prosody: loudness, pitch, and their velocities. Head: velocities of pitch and yaw, `lag_s`
    later. Hotelling, Biometrika 28, 1936; by the singular values of Bjorck and Golub, 1973.
    """
    return _first_canonical(*_features(shown, lag_s))


def canonical_r_shuffled(shown: ShownExpression, lag_s: float = 0.0, seed: int = 0) -> float:
    """The same against other places of the same voice, mean of 20: what chance alone gives."""
    prosody, head = _features(shown, lag_s)
    least = min(round(_LEAST_SHIFT_S / CUE_PERIOD_S), len(head) // 3)
    shifts = np.random.default_rng(seed).integers(least, len(head) - least, _N_SHUFFLED)
    return float(np.mean([_first_canonical(np.roll(prosody, s, axis=0), head) for s in shifts]))


def _features(shown: ShownExpression, lag_s: float) -> tuple[Array, Array]:
    """(n, 4) and (n, 2), n: cues of speech."""
    lag = round(lag_s / CUE_PERIOD_S)
    prosody = [shown.loudness_z, shown.pitch_z]
    prosody += [_velocity(each) for each in prosody]
    head = [np.roll(_velocity(shown.column(f"neck_{axis}_deg")), -lag) for axis in ("pitch", "yaw")]
    rows = shown.is_speaking.copy()
    rows[len(rows) - lag :] = False
    return np.column_stack(prosody)[rows], np.column_stack(head)[rows]


def _first_canonical(one: Array, other: Array) -> float:
    bases = [np.linalg.qr(each - each.mean(axis=0))[0] for each in (one, other)]
    return float(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False)[0])


def _velocity(values: Array) -> Array:
    return np.asarray(np.gradient(values, CUE_PERIOD_S))


def _centred(values: Array) -> Array:
    return np.asarray(values - values.mean())
