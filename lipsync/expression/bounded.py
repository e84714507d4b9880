"""Numbers from outside, made safe: whatever a cue says, motion stays within its limits."""


def bounded(value: float, least: float, most: float) -> float:
    """The value within both limits, infinities included; 0 for what is not a number."""
    if value != value:
        return 0.0
    return least if value < least else most if value > most else value


def smoothstep(share: float) -> float:
    """From 0 to 1 with slope 0 at both ends, 3 u^2 - 2 u^3; steepest in the middle, 1.5."""
    if share <= 0.0:
        return 0.0
    return 1.0 if share >= 1.0 else share * share * (3.0 - 2.0 * share)


def toward(value: float, goal: float, step: float) -> float:
    """One step from a value towards a goal, never beyond it."""
    return min(goal, value + step) if value < goal else max(goal, value - step)
