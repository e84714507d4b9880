"""The methods that are compared: each turns a sentence's phonemes into faces at given times."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from lipservo_lab.baselines.baselines import (
    Dominance,
    fixed_reference,
    spline_faces,
    viseme_centres,
)
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.animpho.selection import (
    STRATEGIES,
    Choice,
    GuidedSelection,
    Joint,
    SelectionStrategy,
)
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.animpho.units import AnimPhoUnits
from lipsync.arrays import Array
from lipsync.expectation.expectation import contexts, track_of
from lipsync.motion.finishing import Style
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, UNIT_STRATEGY, LiveSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent, PhonemeScript, PhonemeUpdate
from lipsync.recognition.scripted import ScriptedPhonemes

#: A label that begins at t is known at t: labels of sound up to t + look-ahead, the border
#: included.
_BORDER_S = 1e-6
REFERENCE = "cohen-massaro"
CATMULL_ROM = "catmull-rom"


@dataclass(frozen=True, slots=True)
class Heard:
    """The phonemes of a sentence, as a method gets them.

    events: all of them, as finally decided. updates: for recognised phonemes, as they were reported
    while the sound went on, in order of `heard_until_s`; empty: the events are labels, known one by
    one as time goes on. latency_s: how much later than its sound the recogniser settles a phoneme.
    sound_path: for methods that use the sound itself.
    """

    events: tuple[PhonemeEvent, ...]
    updates: tuple[PhonemeUpdate, ...] = ()
    latency_s: float = 0.0
    sound_path: Path | None = None


class Method(Protocol):
    """A method to move the mouth."""

    @property
    def name(self) -> str:
        """The method's name on the command line and in results."""

    @property
    def looks_ahead(self) -> bool:
        """Whether the look-ahead makes a difference; if not, the method sees the whole sentence."""

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:
        """Return the faces at given times.

        Parameters
        ----------
        model : TrainedModel
            The face and all that was learned for it.
        heard : Heard
            The phonemes of the sentence.
        times_s : Array
            (n,), ascending.
        lookahead_s : float
            How much of the sound beyond each time is known.

        Returns
        -------
        Array
            Face coefficients (n, n_components).
        """


@dataclass(frozen=True, slots=True)
class DominanceMethod:
    """Cohen and Massaro's dominance functions: tuned in training, or the fixed reference."""

    name: str
    tuned: bool
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees all
        """Return faces from the whole sentence; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        dominance: Dominance = model.baselines.dominance if self.tuned else fixed_reference()
        return dominance.face_at(heard.events, model.baselines.centres, times_s)


@dataclass(frozen=True, slots=True)
class SplineMethod:
    """Catmull-Rom splines through the mean face of each viseme class."""

    name: str = CATMULL_ROM
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees all
        """Return faces from the whole sentence; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        baselines = model.baselines
        targets = viseme_centres(baselines.centres, baselines.counts)
        return spline_faces(heard.events, targets, times_s)


@dataclass(frozen=True, slots=True)
class MeanFaceMethod:
    """The mean face of speech, unmoved."""

    name: str = "mean-face"
    looks_ahead: bool = False

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees nothing
        """Return the same face for all times: the mean of phone centres, without silence.

        Phones are weighted by how often they occur in training.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        spoken = model.baselines.counts.copy()
        spoken[PHONEMES.index(SILENCE)] = 0.0
        mean = np.average(model.baselines.centres, axis=0, weights=spoken if spoken.any() else None)
        return np.repeat(mean[None], len(times_s), axis=0)


@dataclass(frozen=True, slots=True)
class PublishedMethod:
    """Wei and Deng's selection and blending of AnimPhos; it knows each phone's end at its start.

    published_derivatives: as in `PublishedSynthesizer`.
    """

    strategy: SelectionStrategy
    looks_ahead: bool = False
    published_derivatives: bool = False

    @property
    def name(self) -> str:
        """The name of the strategy that selects AnimPhos."""
        return self.strategy.name

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:  # noqa: ARG002 - sees phones whole
        """Return faces with every phone known when it begins; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        synthesizer = self.synthesizer(model)
        synthesizer.push(PhonemeUpdate(0.0, np.inf, np.inf, heard.events))
        return np.array([synthesizer.frame_at(float(t)).coefficients for t in times_s])

    def synthesizer(self, model: TrainedModel) -> PublishedSynthesizer:
        """Return a new synthesiser for one sentence."""
        return PublishedSynthesizer(
            model.animphos, self.strategy, published_derivatives=self.published_derivatives
        )


@dataclass(frozen=True, slots=True)
class RegressionMethod:
    """One linear regression from the phoneme context to the face."""

    name: str = "plain-regression"
    looks_ahead: bool = True

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:
        """Return faces from the contexts known at t + look-ahead; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        phonemes, context_times_s = contexts(track_of(heard.events), times_s, lookahead_s)
        lookaheads_s = np.full(len(times_s), lookahead_s)
        return model.baselines.regression.faces(phonemes, context_times_s, lookaheads_s)


@dataclass(frozen=True, slots=True)
class LiveMethod:
    """The live method: every 10 ms it gets what is known by then, and moves on.

    selection: makes the selection of AnimPhos (recorded pieces of motion); None: the motion is the
    predicted mean alone. strength, smoothness: as in `Style`.
    """

    name: str = LIVE_STRATEGY
    looks_ahead: bool = True
    strength: float = 1.0
    smoothness: float = 0.0
    selection: Callable[[AnimPhoUnits], GuidedSelection] | None = None

    def faces(self, model: TrainedModel, heard: Heard, times_s: Array, lookahead_s: float) -> Array:
        """Return faces decided at t from the sound up to t + look-ahead; see `Method`.

        Parameters
        ----------
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        synthesizer = self.synthesizer(model, lookahead_s)
        source = script_of(heard, lookahead_s)
        faces, n_ticks = [], 0
        for time_s in times_s:
            while n_ticks * TICK_S < time_s - _BORDER_S:
                _push_known(synthesizer, source, n_ticks * TICK_S)
                synthesizer.frame_at(n_ticks * TICK_S)
                n_ticks += 1
            _push_known(synthesizer, source, float(time_s))
            faces.append(synthesizer.frame_at(float(time_s)).coefficients)
        return np.array(faces)

    def synthesizer(self, model: TrainedModel, lookahead_s: float) -> LiveSynthesizer:
        """Return a new live synthesiser with this look-ahead."""
        style = Style(lookahead_s, self.strength, self.smoothness)
        selection = self.selection and self.selection(model.animphos)
        return LiveSynthesizer(model, model.expectation, style, selection, model.soft)


class _RandomSelection(GuidedSelection):
    """Selection that takes a random AnimPho in place of the best: it shows what selecting is worth.

    of_all: draw from all AnimPhos, not only those of the phoneme.
    """

    def __init__(self, units: AnimPhoUnits, *, of_all: bool) -> None:
        super().__init__(units)
        self._of_all = of_all
        self._chance = np.random.default_rng(0)

    def choose(self, phoneme: str, target: Array, joint: Joint) -> Choice:
        """Return a random AnimPho of the phoneme, or of all.

        Parameters
        ----------
        phoneme : str
            One of the model's known phonemes.
        target : Array
            (5, n_components), the wanted face at even times until the phone's end.
        joint : Joint
            State of the mouth that the AnimPho continues.

        Returns
        -------
        Choice
            That of `GuidedSelection.choose`, with the random AnimPho in it.
        """
        candidates = range(len(self.units)) if self._of_all else self.units.of_phoneme(phoneme)
        best = super().choose(phoneme, target, joint)
        return replace(best, animpho=int(self._chance.choice(candidates)))


#: The live method with AnimPhos drawn at random, from those of the phoneme, or from all.
RANDOM_UNITS: Final = tuple(
    LiveMethod(
        f"{UNIT_STRATEGY}:random-of-{pool}",
        selection=partial(_RandomSelection, of_all=pool == "all"),
    )
    for pool in ("phoneme", "all")
)


def all_methods() -> dict[str, Method]:
    """Return every method by its name, the fixed reference first and the live one last."""
    methods: Sequence[Method] = (
        DominanceMethod(REFERENCE, tuned=False),
        DominanceMethod("cohen-massaro-tuned", tuned=True),
        SplineMethod(),
        MeanFaceMethod(),
        *(PublishedMethod(strategy) for strategy in STRATEGIES.values()),
        RegressionMethod(),
        LiveMethod(UNIT_STRATEGY, selection=GuidedSelection),
        LiveMethod(),
    )
    return {method.name: method for method in methods}


class _Replayed:
    """Recorded updates of a recogniser, returned again as time goes on.

    ahead_s: how much earlier than their sound they are known.
    """

    def __init__(self, updates: Sequence[PhonemeUpdate], ahead_s: float) -> None:
        self._updates = updates
        self._ahead_s = ahead_s
        self._n_passed = 0

    def updates(self, until_s: float) -> list[PhonemeUpdate]:
        """Return the updates known at `until_s` that were not returned before.

        An update is known when its sound is at most `ahead_s` (look-ahead and latency) later than
        that.
        """
        known = []
        while self._n_passed < len(self._updates):
            update = self._updates[self._n_passed]
            if update.heard_until_s > until_s + self._ahead_s:
                break
            known.append(update)
            self._n_passed += 1
        return known


def script_of(heard: Heard, lookahead_s: float) -> PhonemeScript:
    """Return the sentence's phonemes as they become known with a look-ahead."""
    if heard.updates:
        return _Replayed(heard.updates, lookahead_s + heard.latency_s)
    return ScriptedPhonemes(heard.events, lookahead_s)


def _push_known(synthesizer: LiveSynthesizer, source: PhonemeScript, time_s: float) -> None:
    """Give the synthesiser the phonemes that become known at `time_s`."""
    for update in source.updates(time_s + _BORDER_S):
        synthesizer.push(update)
