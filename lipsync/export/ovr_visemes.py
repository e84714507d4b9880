"""Weights of the 15 OVR visemes over time, from phonemes.

Names, and the phones of each viseme: Meta, "Viseme Reference" of Oculus Lipsync. Phones that it
does not name get the viseme that looks alike on the lips.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array
from lipsync.motion.finishing import BILABIALS, CLOSING_S, HOLD_S, LABIODENTALS, PARTING_S
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent

OVR_NAMES = ("sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E", "ih", "oh",
             "ou")  # fmt: skip

#: Of each phone one viseme, or the two of a diphthong. HH takes the viseme of the phone after it.
_VISEMES_OF: Mapping[str, tuple[str, ...]] = {
    SILENCE: ("sil",),
    **dict.fromkeys(("P", "B", "M"), ("PP",)),
    **dict.fromkeys(("F", "V"), ("FF",)),
    **dict.fromkeys(("TH", "DH"), ("TH",)),
    **dict.fromkeys(("T", "D"), ("DD",)),
    **dict.fromkeys(("K", "G", "NG"), ("kk",)),
    **dict.fromkeys(("CH", "JH", "SH", "ZH"), ("CH",)),
    **dict.fromkeys(("S", "Z"), ("SS",)),
    **dict.fromkeys(("N", "L"), ("nn",)),
    **dict.fromkeys(("R", "ER"), ("RR",)),
    **dict.fromkeys(("AA", "AH"), ("aa",)),
    **dict.fromkeys(("EH", "AE"), ("E",)),
    **dict.fromkeys(("IH", "IY", "Y"), ("ih",)),
    **dict.fromkeys(("UW", "UH", "W"), ("ou",)),
    "AO": ("oh",),
    "AY": ("aa", "ih"),
    "AW": ("aa", "ou"),
    "EY": ("E", "ih"),
    "OY": ("oh", "ih"),
    "OW": ("oh", "ou"),
}
_FOLLOWS = "HH"
SILENCE_VISEME = "sil"
_FIRST_PART = 0.6  # of a diphthong
#: One viseme takes so long to pass into the next, the shorter of the two permitting: as long as
#: the lips take to close and to part again.
_FADE_S = CLOSING_S + PARTING_S
#: Shorter would be a step.
_SHORTEST_FADE_S = 0.01
_CLOSING = (*BILABIALS, *LABIODENTALS)


@dataclass(frozen=True, slots=True)
class _Part:
    """A viseme from start to end, in s: all of a phone, or a part of a diphthong.

    full_s: when its weight must be 1, because its lips are closed; None: at no certain time.
    """

    viseme: str
    start_s: float
    end_s: float
    full_s: float | None = None


def viseme_weights(events: Iterable[PhonemeEvent], times_s: Array, tightest_s: Array) -> Array:
    """Return the weights of the 15 Oculus visemes over time, for an avatar's mouth.

    Neighbours fade into each other around their border. Where lips close, the viseme's weight is 1
    when the lips are shut. Before and after the phonemes: `sil`.

    Parameters
    ----------
    events : Iterable[PhonemeEvent]
        Phonemes in order of time.
    times_s : Array
        (n_times,) sound times, ascending.
    tightest_s : Array
        (40,) s from each phoneme's onset until the lips are nearest, see FaceModel.

    Returns
    -------
    Array
        (n_times, 15), from 0 to 1, each row's sum 1.
    """
    parts = _viseme_parts(tuple(events), tightest_s)
    weights = np.zeros((len(times_s), len(OVR_NAMES)))
    share = np.ones(len(times_s))
    before = _Part(SILENCE_VISEME, -math.inf, 0.0)
    for part in parts:
        # Of the weight 1, as much as goes to this viseme and later ones: never more than went to
        # the viseme before and later ones, so that no weight is negative.
        later_share = np.minimum(share, _faded_share(before, part, times_s))
        weights[:, OVR_NAMES.index(before.viseme)] += share - later_share
        before, share = part, later_share
    weights[:, OVR_NAMES.index(before.viseme)] += share
    return weights


def _viseme_parts(events: Sequence[PhonemeEvent], tightest_s: Array) -> list[_Part]:
    """Return the visemes of phonemes in order, `sil` in gaps and after the last phoneme.

    tightest_s: (40,), as in `viseme_weights`. A phoneme without an end lasts for ever.
    """
    parts: list[_Part] = []
    end_s = 0.0
    for i, event in enumerate(events):
        if event.start_s > end_s:
            parts.append(_Part(SILENCE_VISEME, end_s, event.start_s))
        end_s = math.inf if event.end_s is None else event.end_s
        if event.phoneme == _FOLLOWS:
            next_phoneme = events[i + 1].phoneme if i + 1 < len(events) else SILENCE
            viseme = _VISEMES_OF.get(next_phoneme, (SILENCE_VISEME,))[0]
            parts.append(_Part(viseme, event.start_s, end_s))
            continue
        visemes = _VISEMES_OF[event.phoneme]
        full_s = None
        if event.phoneme in _CLOSING:
            tightest_at_s = event.start_s + float(tightest_s[PHONEMES.index(event.phoneme)])
            full_s = min(tightest_at_s, end_s) - HOLD_S / 2.0
        border_s = end_s
        if len(visemes) > 1 and math.isfinite(end_s):
            border_s = event.start_s + _FIRST_PART * (end_s - event.start_s)
            parts.append(_Part(visemes[0], event.start_s, border_s))
            parts.append(_Part(visemes[1], border_s, end_s))
        else:
            parts.append(_Part(visemes[0], event.start_s, end_s, full_s))
    if math.isfinite(end_s):
        parts.append(_Part(SILENCE_VISEME, end_s, math.inf))
    return parts


def _faded_share(before: _Part, part: _Part, times_s: Array) -> Array:
    """Return how far the viseme `before` has faded into `part` at each time: (n_times,), 0 to 1."""
    # A closure is complete at its `full_s`; any other viseme fades in around its beginning.
    if part.full_s is not None:
        begin_s, end_s = part.full_s - CLOSING_S, part.full_s
    else:
        fade_s = min(_FADE_S, before.end_s - before.start_s, part.end_s - part.start_s)
        begin_s, end_s = part.start_s - fade_s / 2.0, part.start_s + fade_s / 2.0
    if before.full_s is not None:  # a closure is held before it opens
        begin_s = max(begin_s, before.full_s + HOLD_S)
        end_s = max(end_s, begin_s + _SHORTEST_FADE_S)
    share = np.clip((times_s - begin_s) / max(end_s - begin_s, _SHORTEST_FADE_S), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))
