"""The fault campaign in numbers."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from firmware_bridge.simulator.campaign import cases, play
from firmware_bridge.simulator.faults import KINDS


def campaign_figures(every: int, progress: Callable[[int, int], None]) -> dict[str, float]:
    """Play one case in `every`; what was survived, and how long recovery took."""
    chosen = list(cases())[::every]
    outcomes = []
    with ProcessPoolExecutor(max_workers=2) as pool:
        for outcome in pool.map(play, chosen, chunksize=4):
            outcomes.append(outcome)
            progress(len(outcomes), len(chosen))
    recovered_s = [o.recovery_s for o in outcomes if o.recovery_s is not None]
    return {
        "kinds": len(KINDS),
        "cases": len(outcomes),
        "survived": sum(outcome.survived for outcome in outcomes),
        "goals_outside_limits": sum(outcome.goals_outside_limits for outcome in outcomes),
        "steps_above_clamp": sum(outcome.steps_above_clamp for outcome in outcomes),
        "contention": sum(outcome.contention for outcome in outcomes),
        "torque_unknown": sum(outcome.torque_unknown for outcome in outcomes),
        "recovery_p95_s": float(np.percentile(recovered_s, 95)) if recovered_s else 0.0,
        "never_recovered": len(outcomes) - len(recovered_s),
    }
