"""`lipservo calibrate` was one command with flags: how each is spelled now."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

#: Every option that the one command had, and whether a value followed it.
_OLD_OPTIONS: Mapping[str, bool] = MappingProxyType(
    {
        "--output": True,
        "--config": True,
        "--model": True,
        "--plan": True,
        "--markers": True,
        "--refine": True,
        "--axes": True,
        "--port": True,
        "--sim": True,
        "--tracker": True,
        "--practise": True,
        "--guided": False,
        "--poses": True,
        "--keep": True,
        "--lags": False,
        "--no-lags": False,
        "--speed": True,
        "--ranges": True,
        "--plots": True,
        "--json": False,
        "--quiet": False,
    }
)
_SHORT = {"-o": "--output", "-q": "--quiet"}


def new_spelling(arguments: Sequence[str], options_of: Mapping[str, Iterable[str]]) -> str:
    """What to type instead of `lipservo calibrate ARGUMENTS`, quoted for a shell.

    options_of: the options of each sub-command; what it has not is left out.
    """
    given = _parsed(arguments)
    command, positional = _command_of(given)
    known = set(options_of[command])
    words = ["lipservo", "calibrate", command]
    words += [given.pop(option) or option.strip("-").upper() for option in positional]
    if command == "plan" and "--markers" in given and "--refine" in positional:
        words += ["--refine", given.pop("--plan") or "PLAN"]
    for option, value in given.items():
        if option in known:
            words += [option] if value is None else [option, value]
    return shlex.join(words)


def _command_of(given: Mapping[str, str | None]) -> tuple[str, tuple[str, ...]]:
    """The sub-command, and the old options whose values stand alone in it now."""
    if "--guided" in given:
        return "guided", ()
    if "--tracker" in given:
        return "measure", ()
    if "--practise" in given:
        return "practise", ("--practise",)
    if "--refine" in given and "--plan" in given and "--markers" in given:
        return "plan", ("--refine",)
    if "--plan" in given and "--markers" not in given:
        return "plan", ("--plan",)
    if "--plan" not in given and ("--port" in given or "--sim" in given):
        return "measure", ()
    return "fit", ()


def _parsed(arguments: Sequence[str]) -> dict[str, str | None]:
    """Old options with their values, None for a flag; anything else is left out."""
    given: dict[str, str | None] = {}
    left = list(arguments)
    while left:
        word, equals, value = left.pop(0).partition("=")
        option = _SHORT.get(word, word)
        if word[:2] in _SHORT and not word.startswith("--") and len(word) > 2:
            option, value, equals = _SHORT[word[:2]], word[2:], "="
        if option not in _OLD_OPTIONS:
            continue
        if not _OLD_OPTIONS[option]:
            given[option] = None
        elif equals:
            given[option] = value
        else:
            given[option] = left.pop(0) if left else option.strip("-").upper()
    return given
