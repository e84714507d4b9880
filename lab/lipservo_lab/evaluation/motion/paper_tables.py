"""Tables 2 and 3, Figures 1 and 6 of Wei and Deng in their own form, beside the printed numbers.

Figure 1: the share of ten sentences in which a live recogniser agrees with the labels. Table 2:
RMSE of three clips, drawn at random, with true phonemes (case 1) and live recognised ones (case 2),
over the baseline's. Table 3: the processor time of a phoneme, stage by stage; their clips last two
minutes, ours are sentences of three seconds, and their computer was another one, so only orders of
magnitude compare. Figure 6: miss rates of eight phrases, that is how often selection finds no
AnimPho (recorded piece of motion) that is both of the phoneme and connected. Only ratios compare:
the paper's RMSE has no unit.

Also what the paper prints of its data beside the model's, and how much AnimPhos change the default
motion.
"""

import time
from collections.abc import Iterable, Sequence

import numpy as np

from lipservo.settings.motion_names import DEFAULT_STRATEGY
from lipservo_lab.corpus.utterance import Utterance, speech_frames
from lipservo_lab.evaluation.motion.as_printed import PrintedMethod
from lipservo_lab.evaluation.motion.methods import (
    Heard,
    LiveMethod,
    Method,
    all_methods,
    script_of,
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
from lipsync.animpho.trajectory import (
    Trajectory,
    blend,
    choose_connected,
    sample_derivatives,
    translate,
)
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits
from lipsync.arrays import Array
from lipsync.expectation.expectation import track_of
from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S
from lipsync.motion.live_synthesizer import UNIT_STRATEGY
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent, stand_in


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

#: Table 3 as printed, of three clips. Its total is more than the sum of its parts in the paper too.
PRINTED: dict[str, tuple[float, float, float]] = {
    "recognition_ms": (76.73, 90.13, 93.80),
    "synthesis_ms": (38.56, 39.10, 44.89),
    "blending_ms": (0.16, 0.14, 0.15),
    "total_ms": (128.28, 144.40, 142.23),
    "phonemes_per_s": (8.84, 7.29, 7.43),
    "frames_per_s": (25.62, 30.03, 26.77),
}
#: Equation (6) counts frames at this rate.
_FRAMES_HZ = 30.0


def cost_rows(model: TrainedModel, clip: Utterance, number: int, listen: Listen) -> list[Row]:
    """Return rows of Table 3 for a clip: printed, by the priority strategy, by each live method.

    number: of the clip among the printed ones. Values are means over the phonemes that the
    recogniser found, without silences, in processor time. synthesis: selection, equations (1) and
    (2); blending: equations (3) to (5) and Algorithm 1 at 30 Hz; live methods have no such parts,
    all their work is synthesis. phonemes_per_s: how fast the clip is spoken. frames_per_s: equation
    (6), frames of a phoneme at 30 Hz over its computing time.
    """
    began = time.process_time()
    heard = listen(clip)
    recognition_ms = (time.process_time() - began) * 1e3
    spoken = [e for e in heard.events if e.phoneme != SILENCE and e.end_s is not None]
    n = max(1, len(spoken))
    seconds = sum((e.end_s or e.start_s) - e.start_s for e in spoken)
    synthesis_ms, blending_ms = _published_ms(model, heard)
    stages = {
        "priority": (recognition_ms / n, synthesis_ms / n, blending_ms / n),
        **{
            method.name: (recognition_ms / n, _live_ms(method, model, heard) / n, None)
            for method in _ours()
        },
    }
    rows: list[Row] = []
    for line, printed in PRINTED.items():
        row: Row = {"clip": clip.name, "of_a_phoneme": line, "printed": printed[number]}
        for name, (recognition, synthesis, blending) in stages.items():
            total = recognition + synthesis + (blending or 0.0)
            row[name] = {
                "recognition_ms": recognition,
                "synthesis_ms": synthesis,
                "blending_ms": blending,
                "total_ms": total,
                "phonemes_per_s": n / seconds if seconds else None,
                "frames_per_s": seconds * _FRAMES_HZ / (total * n / 1e3),
            }[line]
        rows.append(row)
    return rows


def _published_ms(model: TrainedModel, heard: Heard) -> tuple[float, float]:
    """Return processor times, ms, of selecting and blending a sentence by the priority strategy."""
    strategy = STRATEGIES["priority"]
    selecting = blending = 0.0
    choice: Choice | None = None
    position = model.rest
    for event in heard.events:
        if event.phoneme == SILENCE:
            choice, position = None, model.rest
            continue
        for phoneme in stand_in(event.phoneme, model.animphos.known_phonemes):
            began = time.process_time()
            before = choice
            choice = (
                strategy.first(model.animphos, phoneme)
                if before is None
                else strategy.following(model.animphos, phoneme, before)
            )
            selected = time.process_time()
            position = _blended(model.animphos, event, before, choice, position)
            selecting += selected - began
            blending += time.process_time() - selected
    return selecting * 1e3, blending * 1e3


def _blended(
    units: AnimPhoUnits,
    event: PhonemeEvent,
    last: Choice | None,
    choice: Choice,
    position: Array,
) -> Array:
    """Compute a phoneme's samples and all its frames, to be timed; return the last sample.

    last: the choice of the phoneme before, None at the beginning. position: (n_components,), where
    the mouth is.
    """
    connected = (
        choice.animpho if last is None else choose_connected(units, last.animpho, choice.animpho)
    )
    samples = blend(translate(units.samples[connected], position), units.samples[choice.animpho])
    duration_s = (event.end_s or event.start_s) - event.start_s
    derivatives = sample_derivatives(samples, np.zeros_like(position))
    trajectory = Trajectory(event.start_s, max(duration_s, 1e-3), samples, derivatives)
    for frame in range(round(duration_s * _FRAMES_HZ)):
        trajectory.at(event.start_s + frame / _FRAMES_HZ)
    return np.asarray(samples[-1])


def _ours() -> list[LiveMethod]:
    """Return the live methods, the default last."""
    ours = [method for method in all_methods().values() if isinstance(method, LiveMethod)]
    return sorted(ours, key=lambda method: method.name == DEFAULT_STRATEGY)


def _live_ms(method: LiveMethod, model: TrainedModel, heard: Heard) -> float:
    """Return a live method's processor time for a sentence at 30 Hz, ms."""
    synthesizer = method.synthesizer(model, DEFAULT_LOOKAHEAD_S)
    script = script_of(heard, DEFAULT_LOOKAHEAD_S)
    end_s = heard.events[-1].end_s or 0.0
    began = time.process_time()
    for frame in range(round(end_s * _FRAMES_HZ)):
        for update in script.updates(frame / _FRAMES_HZ):
            synthesizer.push(update)
        synthesizer.frame_at(frame / _FRAMES_HZ)
    return (time.process_time() - began) * 1e3


N_CLIPS, N_PHRASES, N_HEARD = 3, 8, 10
#: Figure 1: range of the ten sentences' agreement with their forced alignment.
PRINTED_AGREEMENT = (0.45, 0.80)
#: What the paper says of its recordings and of the AnimPhos made of them.
PRINTED_DATA = {
    "sentences": 166, "phonemes": 43, "components": 5, "successors_of_an_animpho": 3.45
}  # fmt: skip
#: Labels and recognised phonemes are compared every so many seconds.
_COMPARED_S = 0.01
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
    """Return rows of data, figure_1, table_2, table_3, figure_6, animphos: ours and the paper's.

    printed: the paper's method as printed; None if its training sentences are missing. listen:
    returns what the live recogniser finds in a sentence (case 2). seed: draws the sentences.
    """
    rng = np.random.default_rng(seed)
    n_drawn = min(len(utterances), N_HEARD)
    picked = [utterances[i] for i in rng.choice(len(utterances), n_drawn, replace=False)]
    drawn, clips = picked[:N_PHRASES], picked[:N_CLIPS]
    return {
        "data": _data_rows(model),
        "figure_1": [_agreement(sentence, listen) for sentence in picked],
        "table_2": [_ratios(model, clip, i, listen, printed) for i, clip in enumerate(clips)],
        "table_3": [
            row
            for number, clip in enumerate(clips)
            for row in cost_rows(model, clip, number, listen)
        ],
        "figure_6": [_misses(model, phrase, printed) for phrase in drawn],
        "animphos": [animpho_use(model, picked)],
    }


def _data_rows(model: TrainedModel) -> list[Row]:
    """Return figures about the paper's data beside the model's, a row each."""
    units = model.animphos
    ours = {
        "sentences": len(model.training_sentences),
        "phonemes": len(units.known_phonemes),
        "components": units.samples.shape[2],
        "successors_of_an_animpho": units.mean_successors,
    }
    return [
        {"figure": name, "printed": PRINTED_DATA[name], "ours": value}
        for name, value in ours.items()
    ]


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


def _agreement(sentence: Utterance, listen: Listen) -> Row:
    """Return the share of speech in which the recogniser finds the labelled phoneme, as a row."""
    times_s = np.arange(0.0, sentence.phones[-1].start_s, _COMPARED_S)
    spoken = _phonemes_at(sentence.phones, times_s)
    heard = _phonemes_at(listen(sentence).events, times_s)
    pairs = [(a, b) for a, b in zip(spoken, heard, strict=True) if a != SILENCE]
    share = sum(a == b for a, b in pairs) / max(1, len(pairs))
    return {"sentence": sentence.name, "printed": list(PRINTED_AGREEMENT), "network": share}


def _phonemes_at(events: Sequence[PhonemeEvent], times_s: Array) -> list[str]:
    """Return the phoneme at each time, SIL in gaps."""
    track = track_of(events)
    indices = np.searchsorted(track.starts_s, times_s, side="right") - 1
    return [PHONEMES[track.phonemes[i]] for i in indices]


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
    methods: list[Method] = [all_methods()["priority"], *_ours()]
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
