"""`status --on` and `stop --on`: the same of faces of other computers, printed as each answers."""

import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import typer

from firmware_bridge.stopping import StopLevel
from lipservo.access.kiosks import Kiosk, KioskError, KioskRequest, ask_kiosks, read_kiosks
from lipservo.commands.run.status_words import motion_words, state_words
from lipservo.runtime.servos.letting_go import Outcome
from lipservo.terminal.output import print_json

#: A dashboard answers at once, from the status that it has.
_STATUS_S: Final = 2.0
#: Easing takes 2 s, a bridge that hangs in it is noticed and its servos let go in as much again.
_END_S: Final = 10.0

#: Of one face: its answer for JSON, the same as text for a person, and whether all is well.
_FaceResult = tuple[dict[str, Any], str, bool]


def status_of_kiosks(on: Path, *, as_json: bool) -> None:
    """Print the status of every face that a YAML lists, as each answers.

    Raises SettingsError; typer.Exit with 1 unless all answer, with this version of lipservo.
    """
    here = version("lipservo")

    def report_of(name: str, answer: dict[str, Any]) -> _FaceResult:
        """Return a dashboard's answer, its text for a person, and whether versions are equal.

        Raises KioskError if the face behind the dashboard does not answer, or its version is too
        old.
        """
        if "version" in answer and not answer.get("face_answers"):
            raise KioskError(f"its dashboard answers, but not its face: {answer.get('trouble')}")
        if not isinstance(answer.get("state"), str):
            there = answer.get("version", "an unknown version")
            raise KioskError(f"runs lipservo {there}, here is {here}; install one version on both")
        line = f"{name}  {answer.get('port') or 'simulated servos'}  {state_words(answer)}"
        there = answer.get("version", "an older one")
        if there != here:
            line += f"\n  its version is {there}, here is {here}; install the same on both"
        for each in filter(None, (motion_words(answer), *answer.get("troubles", ()))):
            line += f"\n  {each}"
        return answer, line, there == here

    _print_answers(
        read_kiosks(on), KioskRequest("GET", "/api/status", _STATUS_S), report_of, as_json=as_json
    )


def stop_kiosks(on: Path, level: StopLevel, *, end: bool, as_json: bool) -> None:
    """Stop every face that a YAML lists, all at once, and print what each has confirmed.

    end: daemons end, too. Raises SettingsError; typer.Exit with 1 unless all servos confirmed.
    """

    def report_of(name: str, answer: dict[str, Any]) -> _FaceResult:
        outcome = _stop_outcome(name, answer, level)
        return outcome.as_dict(), outcome.text(), outcome.is_confirmed

    body = {"level": level.value, "wait_s": _END_S, "end": end}
    # The dashboard waits for the stop's report for `wait_s`, then it answers without one.
    request = KioskRequest("POST", "/api/stop", _END_S + _STATUS_S, body)
    _print_answers(read_kiosks(on), request, report_of, as_json=as_json)


def _stop_outcome(name: str, answer: dict[str, Any], level: StopLevel) -> Outcome:
    """Return the outcome of a stop from the answer of a face's dashboard."""
    outcome = Outcome(name)
    report = answer.get("report")
    if answer.get("accepted") == level.value and level is StopLevel.FREEZE:
        outcome.add_freeze(answer)
    elif answer.get("accepted") == level.value and isinstance(report, dict):
        outcome.add_report(report)
        outcome.not_kept = str(report.get("not_kept", ""))
    elif answer.get("accepted") == level.value:
        outcome.problem = f"will stop, but has not confirmed it within {_END_S:g} s"
    elif "nothing_driven" in answer:
        outcome.problem = "" if answer.get("is_limp") else str(answer["nothing_driven"])
    else:
        outcome.problem = f"answers as no face of version {version('lipservo')} does: look at it"
    return outcome


def _print_answers(
    kiosks: dict[str, Kiosk],
    request: KioskRequest,
    report_of: Callable[[str, dict[str, Any]], _FaceResult],
    *,
    as_json: bool,
) -> None:
    """Send a request to all faces; print a line as each answers, on stderr if the result is JSON.

    report_of: turns (name, answer) into the result of one face, or raises KioskError. Raises
    typer.Exit with 1 unless all faces have answered and all is well.
    """
    stream = sys.stderr if as_json else sys.stdout
    faces: list[dict[str, Any]] = []
    is_good = True

    def tell_waiting(names: Sequence[str]) -> None:
        sys.stderr.write(f"no answer yet: {', '.join(names)}\n")
        sys.stderr.flush()

    for name, answer, seconds in ask_kiosks(kiosks, request, tell_waiting):
        try:
            if isinstance(answer, KioskError):
                raise answer
            fields, line, is_well = report_of(name, answer)
        except KioskError as error:
            fields, line, is_well = {"error": str(error)}, f"{name}: {error}", False
        is_good = is_good and is_well
        faces.append(
            {**fields, "name": name, "url": kiosks[name].url, "answer_s": round(seconds, 3)}
        )
        stream.write(f"{line}\n")
        stream.flush()
    if as_json:
        print_json({"faces": faces})
    if not is_good:
        raise typer.Exit(1)
