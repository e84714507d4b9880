"""The endurance run in numbers, in one session or in several that go on from a file."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Final

from lipservo_lab.campaigns.endurance import MUST_NOT, Endurance, endure
from lipsync.errors import UserError
from lipsync.output_file import check_output, write_whole

#: As many as a mouth needs; more servos cost time, and leak nothing else.
N_SERVOS, RATE_HZ = 5, 100.0
_FORMAT: Final = "lipservo bench endurance 1"
#: Of each session on its own: what it is at its end is not added up.
_OF_A_SESSION: Final = {
    "rss_mb_at_tenth",
    "rss_mb_at_end",
    "descriptors_at_tenth",
    "descriptors_at_end",
}


def endurance_figures(
    n_cycles: int,
    progress: Callable[[int], None],
    stopped: Callable[[], bool],
    resume: Path | None = None,
) -> dict[str, float]:
    """Run `n_cycles` and say what grew, what went wrong on the wire, and how fast it went.

    resume: where the sessions so far are kept, written whole at every hundredth and at the end.
    What it holds counts, and only the cycles that are left are run, with other random faults.
    progress: called with the cycles done, those of earlier sessions included.
    Raises UserError for a file that holds something else or cannot be written.
    """
    past = [] if resume is None else _read_sessions(resume)
    n_past = sum(session.cycles for session in past)

    def note(session: Endurance) -> None:
        if resume is not None:
            write_whole(resume, _as_json([*past, session]))
        progress(n_past + session.cycles)

    if n_past >= n_cycles:
        return totals(past)
    session = endure(
        n_cycles - n_past,
        note,
        n_servos=N_SERVOS,
        rate_hz=RATE_HZ,
        seed=1 + n_past,
        stopped=stopped,
    )
    note(session)
    return totals([*past, session])


def totals(sessions: Sequence[Endurance]) -> dict[str, float]:
    """The sums of all sessions; memory and descriptors of the one in which they grew most.

    rss_growth_mb, descriptors_growth: from a tenth to the end of a session, the worst.
    sessions_too_short: those that ended before their tenth, which say nothing of growth.
    """
    figures: dict[str, float] = {
        field.name: sum(getattr(session, field.name) for session in sessions)
        for field in fields(Endurance)
        if field.name not in _OF_A_SESSION
    }
    warm = [session for session in sessions if session.descriptors_at_tenth]
    for name, growth, unit in (
        ("rss_mb", "rss_growth_mb", 0.0),
        ("descriptors", "descriptors_growth", 0),
    ):
        begin, end = f"{name}_at_tenth", f"{name}_at_end"
        pairs = [(getattr(s, begin), getattr(s, end)) for s in warm] or [(unit, unit)]
        figures[begin], figures[end] = max(pairs, key=lambda pair: pair[1] - pair[0])
        figures[growth] = figures[end] - figures[begin]
    return {
        **figures,
        "sessions": len(sessions),
        "sessions_too_short": len(sessions) - len(warm),
        "servos": N_SERVOS,
        "rate_hz": RATE_HZ,
        "cycles_per_cpu_second": figures["cycles"] / max(figures["cpu_s"], 1e-9),
    }


def what_went_wrong(figures: dict[str, float]) -> list[str]:
    """The counts that must be 0 and are not, a line each."""
    return [f"{name}: {figures[name]:g}, must be 0" for name in MUST_NOT if figures[name]]


def _as_json(sessions: Sequence[Endurance]) -> str:
    kept = {"format": _FORMAT, "sessions": [asdict(session) for session in sessions]}
    return json.dumps(kept, indent=1) + "\n"


def _read_sessions(path: Path) -> list[Endurance]:
    """The sessions in a file of ours, none where there is no file yet."""
    check_output(
        path, replaces=lambda head: _FORMAT.encode() in head, kind="file of `bench endurance`"
    )
    if not path.exists() or not path.stat().st_size:
        return []
    try:
        kept = json.loads(path.read_text())
        return [_session(each) for each in kept["sessions"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise UserError(
            f"{path}: does not hold whole sessions of `bench endurance`; name a new file"
        ) from error


def _session(kept: dict[str, Any]) -> Endurance:
    session = Endurance(**kept)
    for field in fields(Endurance):
        value = getattr(session, field.name)
        wanted = (int,) if field.type is int else (int, float)
        if type(value) not in wanted or not math.isfinite(value) or value < 0:
            raise ValueError(f"{field.name}: {value}")
    return session
