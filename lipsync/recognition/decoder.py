"""From posteriors to phonemes by Viterbi search, in time for closures.

With a delay of D frames, frame n - D is settled (its phoneme becomes final) when frame n was heard.
Every frame in between has the scores of the best head that covers it (that of the longest delay).
A Viterbi search with a penalty for every change of phoneme runs over all of it: the frames after
n - D, known from the quick heads, smooth what is settled without waiting any longer.

After a pause speech needs more evidence to be settled (docs/decisions/ears.md): leaving silence
costs more, so that evidence adds up over frames as in Wald's sequential test (Annals of
Mathematical Statistics 16(2), 1945), and all that is known of the frames after n - D has to be
speech too.
"""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array32
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF

#: Viseme classes of the closures.
_CLOSERS = (VISEME_OF["P"], VISEME_OF["F"])
_SMALLEST = np.float32(1e-6)
#: Silence that has lasted so many frames is a pause (`PAUSE_S` of lipsync.motion.tick_plan is as
#: long): the mouth is on its way to rest.
PAUSE_FRAMES = 17


@dataclass(frozen=True, slots=True)
class DecoderSettings:
    """Penalties and weights, chosen on two speakers not used in training (docs/recognition.md).

    switch_penalty: of a change of phoneme, in natural-log units; closure_penalty: of a change to a
    closure (P B M, F V), which smoothing would remove; closure_bonus: added to a closure's score;
    phone_weight: of the phone within its viseme class, against the class itself. waking_penalty: of
    a change from silence after a pause, added to the penalty of any change; waking_frames: number
    of frames that all have to be speech then, or all that are known if fewer are.
    """

    switch_penalty: float = 2.0
    closure_penalty: float = 0.6
    closure_bonus: float = 0.0
    phone_weight: float = 0.6
    waking_penalty: float = 6.0
    waking_frames: int = 6


#: Where nothing is heard beyond the frame that is due, a penalty mostly delays every change.
QUICK = DecoderSettings(switch_penalty=0.3, closure_penalty=0.15, waking_penalty=1.0)
SMOOTH = DecoderSettings()


@dataclass(frozen=True, slots=True)
class PosteriorFormat:
    """The names and delays that belong to a recogniser's posteriors (n_frames, n_heads, n_names).

    names: phonemes of the last axis. delays: frames that each head waits, rising: in frame k the
    head that waits d frames gives frame k - d. The posteriors of a head in a frame sum to 1; the
    shipped weights are as sure as they are right (docs/decisions/training-of-the-ears.md).
    """

    names: tuple[str, ...]
    delays: tuple[int, ...]


class ViterbiDecoder:
    """Decoder of scores to phonemes, one frame after the other, each settled D frames later.

    heard: the format of the posteriors; its names are `PHONEMES`. delay: D, at least the delay of
    the quickest head. Raises ValueError for other names and for a smaller delay.
    """

    def __init__(
        self,
        heard: PosteriorFormat,
        delay: int,
        settings: DecoderSettings = DecoderSettings(),
    ) -> None:
        """Create the decoder as at the end of a pause. Raises ValueError as the class says.

        heard: format of the posteriors. delay: frames after which a phoneme is settled.
        """
        delays = heard.delays
        if heard.names != PHONEMES:
            raise ValueError("columns of posteriors are not the phonemes, in their order")
        if delay < delays[0]:
            raise ValueError(f"delay of {delay} frames: the network needs {delays[0]}")
        self._delay = delay
        self._head_at_age = best_heads(delays, delay)
        self._delays = delays
        self._settings = settings
        self._penalties = change_penalties(settings)
        # Scores (n_heads, n_phonemes) of the last frames, by frame number modulo the length.
        self._recent = np.zeros((delay + 1, len(delays), len(PHONEMES)), np.float32)
        self._settled_scores = np.zeros(len(PHONEMES), np.float32)
        self._n_heard = 0
        # Frames of silence settled last; the time before the stream counts as a pause.
        self._n_silent = PAUSE_FRAMES
        all_silent = np.zeros((len(delays), len(PHONEMES)), np.float32)
        all_silent[:, SILENCE_INDEX] = 1.0
        #: Scores of a frame in which every head finds silence. `push` of this very array costs
        #: nothing once all stored frames are silence.
        self.silence = self.scores(all_silent)
        self._n_same = 0

    @property
    def is_awake(self) -> bool:
        """Whether speech was settled within the last `PAUSE_FRAMES` (17) settled frames."""
        return self._n_silent < PAUSE_FRAMES

    def scores(self, posteriors: Array32) -> Array32:
        """Return the log scores of posteriors, to be passed to `push` frame by frame.

        A phoneme's score is the weighted sum of its log posterior and that of its viseme class,
        plus a bonus for closures; weight and bonus are in the decoder's settings.

        Parameters
        ----------
        posteriors : Array32
            (..., n_heads, n_phonemes).

        Returns
        -------
        Array32
            The same shape.
        """
        return log_scores(posteriors, self._settings)

    def push(self, scores: Array32) -> tuple[int | None, list[int]]:
        """Decode one frame: settle the phoneme `delay` frames ago, and update the later ones.

        Parameters
        ----------
        scores : Array32
            (n_heads, n_phonemes), as `scores` returns them.

        Returns
        -------
        tuple[int | None, list[int]]
            The phoneme (its number in `PHONEMES`) now settled, None before the first; and those of
            the later frames that a head has scored so far, provisional.
        """
        n, length = self._n_heard, len(self._recent)
        self._n_heard += 1
        self._n_same = self._n_same + 1 if scores is self.silence else 0
        # Nothing but silence is stored by now, so the result is known.
        if self._n_same > 2 * length + PAUSE_FRAMES:
            self._n_silent += 1
            return SILENCE_INDEX, [SILENCE_INDEX] * (self._delay - self._delays[0])
        for head, delay in enumerate(self._delays):
            if delay <= min(n, self._delay):
                self._recent[(n - delay) % length, head] = scores[head]
        oldest, newest = n - self._delay, n - self._delays[0]
        if newest < 0:
            return None, []
        # From the oldest frame that is not settled to the newest that is known.
        first = max(0, oldest)
        frames = [
            self._recent[f % length, self._head_at_age[n - f - self._delays[0]]]
            for f in range(first, newest + 1)
        ]
        best = self._enter_frame(self._settled_scores)[0] + frames[0]
        if oldest >= 0:
            self._settled_scores = best - best.max()
        path = self._path(best, frames[1:])
        # After a pause all is silence until where enough frames on end are speech.
        if not self.is_awake:
            n_waking = min(self._settings.waking_frames, len(path))
            firsts = range(len(path) - n_waking + 1)
            wakes = (n for n in firsts if SILENCE_INDEX not in path[n : n + n_waking])
            n_silent = next(wakes, len(path))
            path[:n_silent] = [SILENCE_INDEX] * n_silent
        if oldest < 0:
            return None, path
        self._n_silent = self._n_silent + 1 if path[0] == SILENCE_INDEX else 0
        return path[0], path[1:]

    def _enter_frame(self, best: Array32) -> tuple[Array32, Array32, int]:
        """Return the phonemes' scores on entering the next frame, by staying or by a change.

        best: (n_phonemes,), scores in the frame before. Also returned: whether staying gives each
        score, (n_phonemes,), and the number of the likeliest phoneme, from which changes come.
        """
        leader = int(best.argmax())
        is_waking = leader == SILENCE_INDEX and not self.is_awake
        changed = best[leader] - self._penalties[int(is_waking)]
        return np.maximum(best, changed), best >= changed, leader

    def _path(self, best: Array32, frames: list[Array32]) -> list[int]:
        """Return the best path's phonemes, from the frame scored `best` through all of `frames`.

        In each of `frames`, scores (n_phonemes,), a phoneme stays, or comes from the best phoneme
        of the frame before at the penalty of a change.
        """
        steps = []
        for scores in frames:
            entered, stays, leader = self._enter_frame(best)
            steps.append((stays, leader))
            best = entered + scores
        state = int(best.argmax())
        path = [state]
        for stays, leader in reversed(steps):
            if not stays[state]:
                state = leader
            path.append(state)
        return path[::-1]


def best_heads(delays: tuple[int, ...], delay: int) -> list[int]:
    """Return which network head is best for frames of each age, from delays[0] to `delay` frames.

    It is the head with the longest of the `delays` that is not above the age.
    """
    return [
        max(index for index, d in enumerate(delays) if d <= age)
        for age in range(delays[0], delay + 1)
    ]


def change_penalties(settings: DecoderSettings) -> Array32:
    """Return the cost of a change from any other phoneme to each phoneme; closures cost less.

    Parameters
    ----------
    settings : DecoderSettings
        Penalties.

    Returns
    -------
    Array32
        (2, n_phonemes): within speech, and from silence after a pause.
    """
    within = np.where(_IS_CLOSURE, settings.closure_penalty, settings.switch_penalty)
    waking = np.where(np.arange(len(PHONEMES)) == SILENCE_INDEX, 0.0, settings.waking_penalty)
    return np.stack((within, within + waking)).astype(np.float32)


def log_scores(posteriors: Array32, settings: DecoderSettings) -> Array32:
    """Return the scores of phonemes: weighted log posteriors of the viseme class and of the phone.

    Parameters
    ----------
    posteriors : Array32
        (..., n_phonemes).
    settings : DecoderSettings
        Weights.

    Returns
    -------
    Array32
        (..., n_phonemes).
    """
    of_class: Array32 = log_class_posteriors(posteriors)[..., _CLASS_OF]
    of_phone: Array32 = np.log(np.maximum(posteriors, _SMALLEST))
    weight = np.float32(settings.phone_weight)
    bonus = np.where(_IS_CLOSURE, np.float32(settings.closure_bonus), np.float32(0.0))
    blended: Array32 = (1 - weight) * of_class + weight * of_phone + bonus
    return blended


def log_class_posteriors(posteriors: Array32) -> Array32:
    """Return the logarithms of the posteriors of the viseme classes.

    Parameters
    ----------
    posteriors : Array32
        (..., n_phonemes).

    Returns
    -------
    Array32
        (..., n_classes), in the order of `VISEME_CLASSES`.
    """
    logs: Array32 = np.log(np.maximum(posteriors @ _MEMBERSHIP, _SMALLEST))
    return logs


SILENCE_INDEX = PHONEMES.index(SILENCE)
_CLASS_OF = np.array([VISEME_OF[phoneme] for phoneme in PHONEMES])
_IS_CLOSURE = np.isin(_CLASS_OF, _CLOSERS)
_MEMBERSHIP: Array32 = np.eye(len(VISEME_CLASSES), dtype=np.float32)[_CLASS_OF]
