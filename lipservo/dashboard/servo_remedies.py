"""Faults of servos in plain words, and what a person can do about each."""

from collections.abc import Callable, Mapping
from typing import Any, Final

from firmware_bridge.bus import HardwareError

#: Of each hardware error: its meaning, and what to do.
_OF_ERROR: Final = {
    HardwareError.INPUT_VOLTAGE: (
        "its supply is outside what it may have",
        "measure the voltage at its plug while the face moves; a long chain needs power at both "
        "ends",
    ),
    HardwareError.OVERHEATING: (
        "it is too hot",
        "let it cool; then feel whether its joint binds, and give it air",
    ),
    HardwareError.ENCODER: (
        "its encoder gives no sense",
        "reboot it; if that comes back, the servo has to be replaced",
    ),
    HardwareError.ELECTRICAL_SHOCK: (
        "its circuit was shocked, or its motor gets too little power",
        "look for a cable that is pinched or loose, then reboot it",
    ),
    HardwareError.OVERLOAD: (
        "it was loaded for longer than it may be",
        "move its joint by hand while it is limp, find what binds, then reboot it",
    ),
}
#: Of servos that are not driven, by state.
_OF_STATE: Final = {
    "waiting": ("does not answer or waits to be spoken to", "look at its plug, cable and power"),
    "cooling": ("limp for a moment, then tried again", "find what its joint binds on"),
    "rebooting": ("being restarted", "wait a second"),
    "failed": (
        "given up after several failures",
        "find what binds or what is loose; then switch its torque on again",
    ),
}  # fmt: skip


def error_words(bits: int | None) -> list[dict[str, str]]:
    """Return {error, meaning, remedy} of each hardware error bit that is set; [] for None."""
    found = [
        {"error": str(error.name).lower().replace("_", " "), "meaning": meaning, "remedy": remedy}
        for error, (meaning, remedy) in _OF_ERROR.items()
        if (bits or 0) & error
    ]
    unknown_bits = (bits or 0) & ~sum(int(each) for each in _OF_ERROR)
    if unknown_bits:
        hint = "look it up in the e-manual of this model, then reboot it"
        found.append({"error": f"{unknown_bits:#04x}", "meaning": "not known here", "remedy": hint})
    return found


def state_words(state: str) -> dict[str, str] | None:
    """Return {meaning, remedy} for a state in which a servo is not driven; None for any other."""
    words = _OF_STATE.get(state)
    return None if words is None else {"meaning": words[0], "remedy": words[1]}


def listed_servos(status: Mapping[str, Any] | None, *, is_fresh: bool) -> list[dict[str, Any]]:
    """Return every servo of a face's status with its readings, faults and remedies, for JSON.

    is_fresh: the status is current; if not, only names and ids of servos are known. What was never
    received is None. While a person has stopped the face, the state of a servo is `limp` or
    `unconfirmed`, as it answered the stop, or `released` where it cannot answer.
    """
    status = status or {}
    report = (status.get("stop_report") or {}) if is_fresh and is_stopped(status) else {}
    unconfirmed: Mapping[str, str] = report.get("unconfirmed") or {}
    at_stop = dict.fromkeys(report.get("confirmed") or (), "limp")
    at_stop |= dict.fromkeys(unconfirmed, "unconfirmed")
    at_stop |= dict.fromkeys(report.get("released") or (), "released")
    release_words = str(report.get("released_words"))
    has_heat = _heat_test(status)
    health = {str(each["name"]): each for each in status.get("health") or ()}
    states: Mapping[str, str] = status.get("servos") or {}
    return [
        _servo_values(name, at_stop.get(name), states.get(name, ""), health.get(name, {}), is_fresh)
        | _answer_values(
            health.get(name, {}), states.get(name, ""), is_fresh=is_fresh, has_heat=has_heat(name)
        )
        | _unconfirmed_trouble(unconfirmed.get(name))
        | (_released_trouble(release_words) if at_stop.get(name) == "released" else {})
        for name in dict.fromkeys([*states, *health, *at_stop])
    ]


def _heat_test(status: Mapping[str, Any]) -> Callable[[str], bool]:
    """Return a function from a servo's name to whether that servo reports its temperature.

    If the face has several buses, the capabilities of the servo's own bus decide. True where the
    status does not say.
    """
    capabilities: Mapping[str, Any] = status.get("capabilities") or {}
    bus_of = dict(zip(status.get("servos") or (), capabilities.get("bus_of") or (), strict=False))
    return lambda name: bool(
        (capabilities["buses"][bus_of[name]] if name in bus_of else capabilities).get("heat", True)
    )


def is_stopped(status: Mapping[str, Any] | None) -> bool:
    """Return whether a person has stopped the face, which now waits for a start."""
    status = status or {}
    return status.get("state") == "stopped" and bool(status.get("stopped"))


def _unconfirmed_trouble(why: str | None) -> dict[str, Any]:
    if why is None:
        return {}
    meaning = f"has not confirmed that it is limp: {why}"
    remedy = "keep your hands away; look at its plug, cable and power"
    return {"trouble": {"meaning": meaning, "remedy": remedy}}


def _released_trouble(words: str) -> dict[str, Any]:
    remedy = "no more is known: switch the servos' power off before you touch them"
    return {"trouble": {"meaning": words, "remedy": remedy}}


def _answer_values(
    health: Mapping[str, Any], state: str, *, is_fresh: bool, has_heat: bool
) -> dict[str, Any]:
    """Return {heard, answers}: whether the servo's readings are known, and it answers now.

    health: the readings, empty before the first; state: its state; is_fresh: both are current.
    has_heat: the servo reports its temperature; its readings then count only with a temperature.
    """
    known = is_fresh and bool(health)
    known = known and (health.get("temperature_degc") is not None or not has_heat)
    return {"heard": known, "answers": known and str(health.get("state") or state) != "waiting"}


_FIGURES: Final = (
    "temperature_degc", "load", "voltage_v", "current_ma", "n_reboots", "n_unanswered", "torque_on",
)  # fmt: skip


def _servo_values(
    name: str, at_stop: str | None, state: str, health: Mapping[str, Any], is_fresh: bool
) -> dict[str, Any]:
    """Return a servo's state, readings, hardware errors and remedy, as JSON values.

    at_stop: its state by its answer to a person's stop; None: no such stop. state: its state in the
    face's status, used if `health`, its readings, has none. is_fresh: status and readings are
    current; if not, the state is `unknown` and readings are None.
    """
    state = at_stop or str(health.get("state") or state) if is_fresh else "unknown"
    readings = health if is_fresh else {}
    bits = readings.get("hardware_errors")
    return {
        "name": name,
        "servo_id": health.get("servo_id"),
        "state": state,
        **{figure: readings.get(figure) for figure in _FIGURES},
        "hardware_errors": bits,
        "errors": error_words(bits),
        "trouble": state_words(state),
    }
