"""Table 2 and Figure 6 of Wei and Deng in their own form, beside the printed numbers.

Table 2: RMSE of three clips, drawn at random, with true phonemes (case 1) and live recognised ones
(case 2), over the baseline's; only ratios compare, since the paper's RMSE has no unit. Figure 6:
miss rates of eight phrases, that is how often selection finds no AnimPho (recorded piece of motion)
that is both of the phoneme and connected.

Also how much AnimPhos change the default motion.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from lipservo_lab.corpus.utterance import Utterance, speech_frames
from lipservo_lab.evaluation.motion.as_printed import PrintedMethod
from lipservo_lab.evaluation.motion.methods import (
    Heard,
    LiveMethod,
    Method,
    all_methods,
)
from lipservo_lab.evaluation.motion.motion_scores import Listen, Scores, add_scores, true_phonemes
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.animpho.selection import (
    STRATEGIES,
    Choice,
    GuidedSelection,
    Joint,
    SelectionStrategy,
)
from lipsync.animpho.trajectory import choose_connected
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits
from lipsync.arrays import Array
from lipsync.expectation.expectation import track_of
from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, UNIT_STRATEGY
from lipsync.phonemes import SILENCE, PhonemeEvent, stand_in


def miss_rate(
    units: AnimPhoUnits, strategy: SelectionStrategy, sentences: Iterable[Sequence[PhonemeEvent]]
) -> float:
    """Return misses (`count_misses`) over all phonemes that follow another; 0 without any."""
    misses, total = count_misses(units, strategy, sentences)
    return misses / total if total else 0.0


def count_misses(
    units: AnimPhoUnits, strategy: SelectionStrategy, sentences: Iterable[Sequence[PhonemeEvent]]
) -> tuple[int, int]:
    """Return the number of misses, and of the phonemes that follow another phoneme.

    A miss: the chosen AnimPho is not in both L(p_t) and T(a_{t-1}) (Wei and Deng, Figure 6). A
    silence begins a new chain, whose first phoneme cannot miss and is not counted.
    """
    misses = total = 0
    for sentence in sentences:
        choice: Choice | None = None
        for event in sentence:
            if event.phoneme == SILENCE:
                choice = None
                continue
            for phoneme in stand_in(event.phoneme, units.known_phonemes):
                if choice is None:
                    choice = strategy.first(units, phoneme)
                    continue
                choice = strategy.following(units, phoneme, choice)
                misses += choice.missed
                total += 1
    return misses, total


Row = dict[str, object]


N_CLIPS, N_PHRASES, N_DRAWN = 3, 8, 10
LOOKAHEAD_MS = 100
#: Table 2 as printed: the method's RMSE over the baseline's, of three clips, in cases 1 and 2.
PRINTED_CASE_1 = (0.842, 0.884, 0.985)
PRINTED_CASE_2 = (1.081, 1.151, 1.063)
#: Figure 6 has no printed numbers but for "about 50 %" of the priority strategy.
PRINTED_PRIORITY_MISSES = 0.5


def paper_tables(
    model: TrainedModel,
    utterances: Sequence[Utterance],
    listen: Listen,
    printed: PrintedMethod | None,
    *,
    seed: int = 0,
) -> dict[str, list[Row]]:
    """Return rows of table_2, figure_6 and animphos: ours and the paper's.

    printed: the paper's method as printed; None if its training sentences are missing. listen:
    returns what the live recogniser finds in a sentence (case 2). seed: draws the sentences.
    """
    rng = np.random.default_rng(seed)
    n_drawn = min(len(utterances), N_DRAWN)
    picked = [utterances[i] for i in rng.choice(len(utterances), n_drawn, replace=False)]
    clips = enumerate(picked[:N_CLIPS])
    return {
        "table_2": [_ratios(model, clip, number, listen, printed) for number, clip in clips],
        "figure_6": [_misses(model, phrase, printed) for phrase in picked[:N_PHRASES]],
        "animphos": [animpho_use(model, picked)],
    }


class _CountedSelection(GuidedSelection):
    """Selection that counts its plans, and those in which b_t, eq. (3), is not a_t.

    A plan is a choice of an AnimPho a_t for a phoneme; b_t is the one that is connected to the
    last.
    """

    n_plans = n_used = 0

    def choose(self, phoneme: str, target: Array, joint: Joint) -> Choice:
        """Return the choice of `GuidedSelection.choose`, and count it."""
        chosen = super().choose(phoneme, target, joint)
        self.n_plans += 1
        if joint.previous is not None:
            connected = choose_connected(self.units, joint.previous.animpho, chosen.animpho)
            self.n_used += connected != chosen.animpho
        return chosen


def animpho_use(model: TrainedModel, sentences: Sequence[Utterance]) -> Row:
    """Return how much AnimPhos change the default motion of sentences.

    animpho_variance: mean square of what they add to the predicted mean motion, over the variance
    of that motion, all components together; transition_used: share of plans in which b_t, eq. (3),
    is not a_t. Frames of speech, with true phonemes and `LOOKAHEAD_MS`.
    """
    counted: list[_CountedSelection] = []

    def make_selection(units: AnimPhoUnits) -> GuidedSelection:
        counted.append(_CountedSelection(units))
        return counted[-1]

    ours = LiveMethod(UNIT_STRATEGY, selection=make_selection)
    expected, added = [], []
    for sentence in sentences:
        times_s = np.arange(len(sentence.markers_mm)) / sentence.frame_rate_hz
        heard, spoken = Heard(sentence.phones), speech_frames(sentence)
        played, mean_motion = (
            method.faces(model, heard, times_s, LOOKAHEAD_MS / 1e3)[spoken]
            for method in (ours, LiveMethod())
        )
        expected.append(mean_motion)
        added.append(played - mean_motion)
    variance = np.concatenate(expected).var(axis=0).sum()
    return {
        "animpho_variance": float((np.concatenate(added) ** 2).mean(axis=0).sum() / variance),
        "transition_used": sum(counts.n_used for counts in counted)
        / max(1, sum(counts.n_plans for counts in counted)),
    }


def _ratios(
    model: TrainedModel,
    clip: Utterance,
    number: int,
    listen: Listen,
    printed: PrintedMethod | None,
) -> Row:
    """Return a row of Table 2: a clip's error over the baseline's, by method and case.

    number: of the clip among the printed ones. listen: returns the recognised phonemes (case 2).
    printed: the paper's method as printed, or None.
    """
    row: Row = {
        "clip": clip.name,
        "printed_case_1": PRINTED_CASE_1[number],
        "printed_case_2": PRINTED_CASE_2[number],
    }
    every = all_methods()
    methods: list[Method] = [every["priority"], every[UNIT_STRATEGY], every[LIVE_STRATEGY]]
    if printed is not None:
        methods.append(printed)
    for case, phonemes_of in {"case_1": true_phonemes, "case_2": listen}.items():
        scores = Scores()
        add_scores(scores, model, [clip], methods, (LOOKAHEAD_MS,), listen=phonemes_of)
        for method in methods:
            row[f"{method.name}_{case}"] = scores.row(method.name, LOOKAHEAD_MS)["ratio"]
    return row


def _misses(model: TrainedModel, phrase: Utterance, printed: PrintedMethod | None) -> Row:
    """Return a row of Figure 6: each strategy's miss rate in a phrase."""
    rates = {
        name: miss_rate(model.animphos, strategy, [phrase.phones])
        for name, strategy in STRATEGIES.items()
    }
    rates[UNIT_STRATEGY] = guided_misses(model, phrase.phones)
    if printed is not None:
        priority = STRATEGIES["priority"]
        component_rates = [miss_rate(units, priority, [phrase.phones]) for units in printed.units]
        rates[printed.name] = sum(component_rates) / len(component_rates)
    return {"phrase": phrase.name, "printed_priority": PRINTED_PRIORITY_MISSES, **rates}


def guided_misses(model: TrainedModel, phones: Sequence[PhonemeEvent]) -> float:
    """Return the miss rate of AnimPhos chosen near the predicted mean motion.

    Each phone is planned once, when it begins, with its end known.
    """
    units, track = model.animphos, track_of(phones)
    selection = GuidedSelection(units)
    previous: Choice | None = None
    misses = total = 0
    for event in phones:
        if event.phoneme == SILENCE or event.end_s is None:
            previous = None
            continue
        phonemes = stand_in(event.phoneme, units.known_phonemes)
        phoneme_s = (event.end_s - event.start_s) / len(phonemes)
        for number, phoneme in enumerate(phonemes):
            spacing_s = phoneme_s / (SAMPLES_PER_ANIMPHO - 1)
            begin_s = event.start_s + number * phoneme_s
            times_s = begin_s + spacing_s * np.arange(float(SAMPLES_PER_ANIMPHO))
            known_s = event.start_s + DEFAULT_LOOKAHEAD_S
            target = model.expectation.faces_after(track, times_s, known_s)
            speed = (target[1] - target[0]) / spacing_s
            joint = Joint(0.0, target[0], speed, spacing_s, previous)
            chosen = selection.choose(phoneme, target, joint)
            if previous is not None:
                misses += chosen.missed
                total += 1
            previous = chosen
    return misses / total if total else 0.0
