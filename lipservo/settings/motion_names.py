"""The names and bounds that a person may choose for motion: strategies, recognisers, styles.

They are a module of their own, since the modules with the strategies and recognisers are slow to
load, and the command line and the face YAML need the names only.
"""

from typing import Final, Literal, get_args

#: What the benchmarks measure.
MeasuredEngine = Literal["network", "energy"]
#: How phonemes become motion: our two, and the two of Wei and Deng.
Strategy = Literal["expected", "animpho", "priority", "naive"]

STRATEGIES: Final[tuple[Strategy, ...]] = get_args(Strategy)
DEFAULT_STRATEGY: Final[Strategy] = "animpho"
#: What each strategy lets its user set; the paper's plays what was recorded, in its own time.
STYLE_NAMES: Final = ("lookahead_ms", "strength", "stage", "smoothness", "unit_share")
#: The most that each may be; the least is 0. `lipsync.motion.live_synthesizer` says why.
LONGEST_LOOKAHEAD_MS: Final = 1000.0
STRONGEST: Final = 1.5
SMOOTHEST: Final = 1.0
ONLY_UNITS: Final = 1.0
ON_STAGE: Final = 1.0
#: Of the face, whatever the strategy: lips so much more open, or less; as much either way.
LIP_GAP_OFFSET: Final = "lip_gap_offset_mm"
FARTHEST_LIP_GAP_OFFSET_MM: Final = 3.0
STYLES_OF: Final[dict[Strategy, tuple[str, ...]]] = {
    "expected": STYLE_NAMES[:4],
    "animpho": STYLE_NAMES,
    "priority": ("strength", "stage"),
    "naive": ("strength", "stage"),
}
