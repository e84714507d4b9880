"""A face's status in words for a person."""

from typing import Any


def state_words(status: dict[str, Any]) -> str:
    """Return a face's state as text: stop report, missing port, dry run, or servos that hold."""
    report = status.get("stop_report")
    if status["state"] == "stopped" and report is not None:
        n, left = len(report["confirmed"]), ", ".join(report["unconfirmed"])
        # Servos that cannot confirm it, and those that did; the latter also if no others exist.
        words = [report.get("released_words"), f"limp, confirmed by {n} servos"]
        limp = "; ".join(filter(None, words if n else words[:1])) or words[1]
        limp += f", NOT by {left}" if left else ""
        limp += "; `lipservo start` drives it" if status.get("can_start") else ""
        return f"stopped by {status.get('stopped_by')}: {limp}"
    if status.get("plugged") is False:
        return f"{status['state']}, but its port is gone: no servo can be reached"
    dry_run = ", dry run: servos are only read" if status.get("dry_run") else ""
    return f"{status['state']}{dry_run}{servo_words(status)}"


def servo_words(status: dict[str, Any]) -> str:
    """Return how many servos of a face hold, as text that follows its state; else empty."""
    known = [each.get("on") for each in dict(status.get("torque") or {}).values()]
    if set(known) == {None}:
        return ", it is not known which servos hold"
    unknown = f", not known of {known.count(None)}" if None in known else ""
    return f", {known.count(True)} of {len(known)} servos hold{unknown}" if known else ""


def motion_words(status: dict[str, Any]) -> str:
    """Return a speaking face's sound, strategy, settings and recogniser as one line; else empty."""
    if status.get("strategy") is None:
        return ""
    level = status["fallback_level"]
    fallback = f" (fallback {level})" if level else ""
    listens = f"; listens at {status['listens_on']}" if status.get("listens_on") else ""
    named = "".join(f", {name} {value:g}" for name, value in status["settings"].items())
    opens = "; does not close" if status.get("mouth_closes") is False else ""
    heard = f"{status['recognizer']}{fallback}{listens}{opens}"
    return f"{status['sound']}: {status['strategy']}{named}; {heard}"
