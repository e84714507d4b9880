"""The choice of how sound becomes motion: recogniser, motion strategy and style."""

import logging
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from firmware_bridge.process.commands import Setting
from lipservo.settings.motion_names import (
    DEFAULT_STRATEGY,
    ON_STAGE,
    ONLY_UNITS,
    SMOOTHEST,
    STRATEGIES,
    STRONGEST,
    STYLE_NAMES,
    STYLES_OF,
    Strategy,
)
from lipservo.settings.sections import MotionSettings
from lipsync.errors import UserError
from lipsync.expectation.expectation import read_expectation
from lipsync.expectation.soft_expectation import SoftExpectation, read_soft_expectation
from lipsync.face.frame import Synthesizer
from lipsync.face.model import FaceModel, ModelError, ModelFile, open_model, read_face
from lipsync.motion.finishing import (
    DEFAULT_LOOKAHEAD_S,
    DEFAULT_UNIT_SHARE,
    FinishedSynthesizer,
    Style,
    StyleError,
)
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, UNIT_STRATEGY, LiveSynthesizer
from lipsync.plugins import DEFAULT_RECOGNIZER, RECOGNIZERS
from lipsync.recognition.network import (
    DEFAULT_WEIGHTS,
    LATENCY_S,
    SHIPPED,
    WeightsError,
    adapted_from,
    check_weights,
    weights_digest,
)

_LOG = logging.getLogger(__name__)

#: For `--low-latency`: the best of those with which a goal follows its sound within 150 ms
#: (docs/benchmarks.md, From microphone to bus).
LOW_LATENCY_S = 0.045
LOW_LATENCY_LOOKAHEAD_S = 0.05
#: No output of the network waits longer for the sound after a phoneme.
LONGEST_LATENCY_S = 1.0
#: Style settings that may change while a face runs, with their upper limits. The look-ahead stays:
#: it is part of the delay from sound to face, which is declared at the start.
_LIVE_SETTINGS = {
    "strength": STRONGEST,
    "stage": ON_STAGE,
    "smoothness": SMOOTHEST,
    "unit_share": ONLY_UNITS,
}


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """The recogniser to begin with, the motion strategy by name, and the style of the motion.

    weights: name of shipped weights, or a file; checked here, since a live face would silently fall
    back to a lesser recogniser. recognizer_latency_s: seconds of sound after a phoneme before it is
    final; fewer are less accurate. performed: how the performance being played was rendered; if not
    empty, no recogniser runs and no strategy plans anything. Raises WeightsError, StyleError,
    PluginError.
    """

    engine: str = DEFAULT_RECOGNIZER
    weights: str = DEFAULT_WEIGHTS
    strategy: Strategy = DEFAULT_STRATEGY
    style: Style = field(default_factory=Style)
    recognizer_latency_s: float = LATENCY_S
    performed: str = ""

    def __post_init__(self) -> None:
        """Raise WeightsError, PluginError or StyleError for a setting that cannot be used."""
        check_weights(self.weights)
        RECOGNIZERS.check(self.engine)
        if self.strategy not in STRATEGIES:
            raise StyleError(
                f"unknown strategy {self.strategy!r}; use one of {', '.join(STRATEGIES)}"
            )
        if not 0.0 < self.recognizer_latency_s <= LONGEST_LATENCY_S:
            raise StyleError(
                f"recognizer_latency_s is {self.recognizer_latency_s}; allowed: above 0 to "
                f"{LONGEST_LATENCY_S}"
            )

    @property
    def style_settings(self) -> dict[str, float]:
        """The style settings of the strategy, by their names in the face YAML.

        Empty while a performance is played, whose motion is rendered already.
        """
        if self.performed:
            return {}
        named = {**asdict(self.style), "lookahead_ms": self.style.lookahead_s * 1e3}
        return {name: round(named[name], 6) for name in STYLES_OF[self.strategy]}

    def live_settings(self) -> dict[str, Setting]:
        """Return the style settings that may change while a face runs: value and limits by name."""
        values = self.style_settings
        return {
            name: Setting(values[name], 0.0, most)
            for name, most in _LIVE_SETTINGS.items()
            if name in values
        }

    def __str__(self) -> str:
        """Return strategy, style and recogniser in one line, or how a performance was rendered."""
        if self.performed:
            return f"performance, rendered by {self.performed}"
        style = ", ".join(f"{name} {value:g}" for name, value in self.style_settings.items())
        return (
            f"strategy {self.strategy}{f' ({style})' if style else ''}; "
            f"recogniser {self.engine}, weights {self.weights}"
        )


@dataclass(frozen=True, slots=True)
class ChosenMotion:
    """The motion options typed on the command line; None: not typed, the face's YAML decides."""

    engine: str | None = None
    weights: str | None = None
    strategy: Strategy | None = None
    lookahead_ms: float | None = None
    strength: float | None = None
    smoothness: float | None = None
    unit_share: float | None = None
    low_latency: bool = False


def motion_options(
    chosen: ChosenMotion, of_the_face: MotionSettings, folder: Path | None, stage: float = 0.0
) -> MotionOptions:
    """Return the motion options: as typed, else as in the face's YAML, else the defaults.

    chosen: typed on the command line. of_the_face: from the YAML. folder: of the YAML, to which its
    weights file is relative; None: a shipped face. stage: that setting where the YAML has none;
    1 for faces that are only drawn. Raises UserError for an option that the strategy ignores,
    WeightsError and StyleError.
    """
    strategy = chosen.strategy or of_the_face.strategy or DEFAULT_STRATEGY
    low_latency = chosen.low_latency or of_the_face.low_latency
    if low_latency:
        _refuse_low_latency_conflicts(chosen, of_the_face)
        chosen = replace(chosen, lookahead_ms=LOW_LATENCY_LOOKAHEAD_S * 1e3)
    ignored = [
        f"--{name.replace('_', '-')}"
        for name in STYLE_NAMES
        if getattr(chosen, name, None) is not None and name not in STYLES_OF[strategy]
    ]
    if ignored:
        raise UserError(
            f"{', '.join(ignored)}: strategy {strategy} ignores it; leave it out, or take "
            f"--strategy {DEFAULT_STRATEGY}"
        )

    def style(name: str, default: float) -> float:
        """Return a style setting: as typed, else from the YAML, else, or if not used, `default`."""
        if name not in STYLES_OF[strategy]:
            return default
        for value in (getattr(chosen, name, None), getattr(of_the_face, name)):
            if value is not None:
                return float(value)
        return default

    weights = of_the_face.weights
    if weights is not None and weights not in SHIPPED and folder is not None:
        weights = str(folder / weights)
    return MotionOptions(
        chosen.engine or of_the_face.engine or DEFAULT_RECOGNIZER,
        chosen.weights or weights or DEFAULT_WEIGHTS,
        strategy,
        Style(
            style("lookahead_ms", DEFAULT_LOOKAHEAD_S * 1e3) / 1e3,
            style("strength", 1.0),
            style("smoothness", 0.0),
            style("unit_share", DEFAULT_UNIT_SHARE),
            style("stage", stage),
        ),
        LOW_LATENCY_S if low_latency else LATENCY_S,
    )


def _refuse_low_latency_conflicts(chosen: ChosenMotion, of_the_face: MotionSettings) -> None:
    """Raise UserError for an option, typed or in the YAML, that --low-latency excludes."""
    conflicts = [] if chosen.lookahead_ms is None else ["--lookahead-ms"]
    fast = (None, LIVE_STRATEGY, UNIT_STRATEGY)
    for name, possible in (("strategy", fast), ("engine", (None, DEFAULT_RECOGNIZER))):
        typed, written = getattr(chosen, name), getattr(of_the_face, name)
        if typed not in possible:
            conflicts.append(f"--{name} {typed}")
        elif typed is None and written not in possible:
            conflicts.append(f"the face's `{name}: {written}`")
    if conflicts:
        raise UserError(f"--low-latency and {conflicts[0]} contradict each other; leave one out")


def make_synthesizer(
    face: FaceModel, options: MotionOptions, model_path: Path | None = None
) -> Synthesizer:
    """Return the synthesiser for the strategy in `options`, with its style applied.

    Strategies `expected` and `animpho` have a LiveSynthesizer. The others have the published method
    (Wei and Deng), with one of its ways to select AnimPhos, recorded pieces of mouth motion.
    model_path: the file from which `face` was read, None: the shipped one; only parts that the
    strategy needs are read. Raises ModelError, also if the file has changed since.
    """
    with open_model(model_path) as file:
        if read_face(file).checksum != face.checksum:
            raise ModelError(f"{file.name}: was changed while it was read; try again")
        style = options.style
        # Predicted motion alone: from decided phonemes, blended with that from their probabilities.
        if options.strategy == LIVE_STRATEGY:
            expectation = read_expectation(file, face.n_components)
            return LiveSynthesizer(face, expectation, style, soft=_soft_map(file, face, options))
        from lipsync.animpho import selection
        from lipsync.animpho.synthesizer import PublishedSynthesizer
        from lipsync.animpho.units import ANIMPHO_PART, read_animphos

        if not file.has(ANIMPHO_PART):
            raise ModelError(
                f"{file.name}: lacks the AnimPhos that strategy {options.strategy} needs; write "
                f"`motion: {{strategy: {LIVE_STRATEGY}}}` in the face's YAML, or train it again "
                "with `lipservo learn face`"
            )
        units = read_animphos(file, face)
        # Recorded pieces near the predicted motion.
        if options.strategy == UNIT_STRATEGY:
            expectation = read_expectation(file, face.n_components)
            soft = _soft_map(file, face, options)
            return LiveSynthesizer(face, expectation, style, selection.GuidedSelection(units), soft)
        published = PublishedSynthesizer(units, selection.STRATEGIES[options.strategy])
        return FinishedSynthesizer(face, published, style.strength, stage=style.stage)


def _soft_map(file: ModelFile, face: FaceModel, options: MotionOptions) -> SoftExpectation | None:
    """Read the map from phoneme probabilities to face coefficients; None: `file` has none.

    It is used even if it was fitted to other recogniser weights than those in `options`, or those
    from which these were adapted; then a warning is logged.
    """
    soft_map = read_soft_expectation(file, face.n_components)
    provenance = file.about.get("provenance")
    fitted_weights = provenance.get("soft_weights") if isinstance(provenance, dict) else None
    if soft_map is not None and options.engine == DEFAULT_RECOGNIZER:
        with suppress(WeightsError):  # damaged weights are reported where they are loaded
            used_weights = (weights_digest(options.weights), adapted_from(options.weights))
            if fitted_weights is None or fitted_weights not in used_weights:
                _LOG.warning(
                    "%s was not fitted to the recogniser's weights %s, so motion is less exact; "
"`lipservo learn soft` fits it", file.name, options.weights,
                )  # fmt: skip
    return soft_map
