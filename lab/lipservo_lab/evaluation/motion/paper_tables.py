"""Tables 2 and 3 and Figure 6 of Wei and Deng in their own form, beside the printed numbers.

Table 2: RMSE of three clips, drawn at random, with true phonemes (case 1) and live recognised ones
(case 2, once for each recogniser), over the baseline's. Table 3: what a phoneme costs
(paper_costs.py). Figure 6: miss rates of eight phrases. Only ratios compare: the paper's RMSE has
no unit.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.motion.methods import all_methods
from lipservo_lab.evaluation.motion.miss_rates import miss_rate
from lipservo_lab.evaluation.motion.motion_scores import Listen, Scores, add_scores, true_phonemes
from lipservo_lab.evaluation.motion.paper_costs import cost_rows
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.animpho.selection import STRATEGIES
from lipsync.motion.live_synthesizer import LIVE_STRATEGY

N_CLIPS, N_PHRASES = 3, 8
LOOKAHEAD_MS = 100
#: As printed: case 1 and case 2 over the baseline.
PRINTED_CASE_1 = (0.842, 0.884, 0.985)
PRINTED_CASE_2 = (1.081, 1.151, 1.063)
#: Figure 6 has no printed numbers but for "about 50 %" of the priority strategy.
PRINTED_PRIORITY_MISSES = 0.5

Row = dict[str, object]


def paper_tables(
    model: TrainedModel,
    utterances: Sequence[Utterance],
    recognizers: Mapping[str, Listen],
    *,
    seed: int = 0,
) -> dict[str, list[Row]]:
    """Rows of table_2, table_3 and figure_6; ours stands beside the paper's own strategy.

    recognizers: by name; the first is the one in use, whose columns end in `case_2`, the others'
    in `case_2_NAME`.
    """
    rng = np.random.default_rng(seed)
    n_drawn = min(len(utterances), N_PHRASES)
    drawn = [utterances[i] for i in rng.choice(len(utterances), n_drawn, replace=False)]
    clips = drawn[:N_CLIPS]
    return {
        "table_2": [_ratios(model, clip, i, recognizers) for i, clip in enumerate(clips)],
        "table_3": [
            row
            for number, clip in enumerate(clips)
            for row in cost_rows(model, clip, number, next(iter(recognizers.values())))
        ],
        "figure_6": [_misses(model, phrase) for phrase in drawn],
    }


def _ratios(
    model: TrainedModel, clip: Utterance, number: int, recognizers: Mapping[str, Listen]
) -> Row:
    row: Row = {
        "clip": clip.name,
        "printed_case_1": PRINTED_CASE_1[number],
        "printed_case_2": PRINTED_CASE_2[number],
    }
    methods = [all_methods()[name] for name in ("priority", LIVE_STRATEGY)]
    cases: dict[str, Listen] = {"case_1": true_phonemes}
    for name, listen in recognizers.items():
        cases[f"case_2_{name}" if "case_2" in cases else "case_2"] = listen
    for case, hear in cases.items():
        scores = Scores()
        add_scores(scores, model, [clip], methods, (LOOKAHEAD_MS,), listen=hear)
        for method in methods:
            row[f"{method.name}_{case}"] = scores.row(method.name, LOOKAHEAD_MS)["ratio"]
    return row


def _misses(model: TrainedModel, phrase: Utterance) -> Row:
    rates = {
        name: miss_rate(model.animphos, strategy, [phrase.phones])
        for name, strategy in STRATEGIES.items()
    }
    return {"phrase": phrase.name, "printed_priority": PRINTED_PRIORITY_MISSES, **rates}
