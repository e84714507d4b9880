"""Parse fault scripts: YAML that lists faults of simulated servos, and their times.

docs/simulator.md has an example and the table of kinds.
"""

import math
from collections.abc import Mapping
from itertools import accumulate
from typing import Any, Final

import yaml

from firmware_bridge.simulator.faults import (
    AMOUNTS,
    KINDS,
    LASTING,
    ON_INSTRUCTIONS,
    ON_REPLIES,
    Bounds,
    Fault,
)

_LONGEST_S: Final = 1e9
_TIME: Final = Bounds(0.0, _LONGEST_S)
#: Of the keys that many kinds may have.
_BOUNDS: Final = {
    "probability": Bounds(0.0, 1.0),
    "every_s": Bounds(0.001, _LONGEST_S),
    **dict.fromkeys(("from_s", "until_s", "lasts_s"), _TIME),
}
#: A list of mappings of lists is 3 deep.
_DEEPEST: Final = 20


class FaultScriptError(ValueError):
    """A script that cannot be used; in one line: which fault, which key, and what is allowed."""


class _StrictLoader(yaml.SafeLoader):
    """A YAML loader of plain values; refuses a key given twice, where PyYAML keeps the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping's values. Raises ConstructorError for a key that is given twice."""
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    problem = f"`{key.value}` is given twice"
                    raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def read_faults(text: str | None, n_servos: int) -> tuple[int, tuple[Fault, ...]]:
    """Return (seed, faults) of the YAML script `text`; (0, ()) for None.

    n_servos: length of the simulated chain, whose indices the script may use. Raises
    FaultScriptError for an invalid script.
    """
    if text is None:
        return 0, ()
    content = _load(text)
    if not isinstance(content, dict) or set(content) - {"seed", "faults"}:
        raise FaultScriptError("a fault script needs `faults: [...]` and may have `seed: <number>`")
    seed = content.get("seed", 0)
    if not isinstance(seed, int) or isinstance(seed, bool):
        raise FaultScriptError(f"seed: must be a whole number, found {_shown(seed)}")
    listed = content.get("faults")
    if not isinstance(listed, list):
        raise FaultScriptError(f"faults: must be a list, found {_shown(listed)}")
    faults = (_Reader(n, raw, n_servos).fault() for n, raw in enumerate(listed, start=1))
    return seed, tuple(faults)


def _load(text: str) -> object:
    """Parse the YAML of a fault script. Raises FaultScriptError with the line and the reason."""
    if _bracket_depth(text) > _DEEPEST:  # PyYAML takes seconds for thousands of them
        raise FaultScriptError("not a fault script: nested too deep")
    try:
        return yaml.load(text, Loader=_StrictLoader)  # a SafeLoader
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f" at line {error.problem_mark.line + 1}"
        raise FaultScriptError(f"not YAML{line}: {error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise FaultScriptError(f"not YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise FaultScriptError("not a fault script: nested too deep") from error
    except ValueError as error:  # a date of month 13, a number of 5,000 digits
        raise FaultScriptError("a number or date is impossible; correct it") from error


def _bracket_depth(text: str) -> int:
    """Return the greatest depth of open brackets in a text; brackets in quotes count, too."""
    depths = accumulate((each in "[{") - (each in "]}") for each in text)
    return max(depths, default=0)


class _Reader:
    """A parser of one entry of the list of faults; refuses unknown kinds and keys."""

    def __init__(self, number: int, raw: object, n_servos: int) -> None:
        """Check kind and keys of `raw`, the entry of this number. Raises FaultScriptError."""
        self._where = f"fault {number}"
        self._n_servos = n_servos
        if not isinstance(raw, Mapping):
            raise self._wrong("", "must be a mapping like {kind: reboot, at_s: 3.0}", raw)
        kind = raw.get("kind")
        if not isinstance(kind, str) or kind not in KINDS:
            raise self._wrong("kind", f"must be one of {', '.join(KINDS)}", kind)
        self._where = f"fault {number} ({kind})"
        self._kind, self._raw = kind, raw
        self._by_chance = kind in ON_REPLIES | ON_INSTRUCTIONS
        allowed = self._allowed()
        for key in raw:
            if key not in allowed:
                raise FaultScriptError(
                    f"{self._where}: {_shown(key)} does not belong here; "
                    f"this kind has {', '.join(allowed)}"
                )

    def fault(self) -> Fault:
        """Return the entry's fault. Raises FaultScriptError for an invalid or missing value.

        `servos` and `at_s` may be one number or a list.
        """
        amount = AMOUNTS.get(self._kind)
        if not self._by_chance:
            self._check_times()
        values: dict[str, Any] = {}
        if "servos" in self._raw:
            values["servos"] = self._numbers("servos", Bounds(0, self._n_servos - 1, whole=True))
        if "at_s" in self._raw:
            values["at_s"] = tuple(sorted(self._numbers("at_s", _TIME)))
        for key, bounds in _BOUNDS.items():
            if key in self._raw:
                values[key] = self._number(key, self._raw[key], bounds)
        if amount is not None and ("amount" in self._raw or amount.needed):
            values["amount"] = self._number("amount", self._raw.get("amount"), amount)
        if values.get("until_s", math.inf) <= values.get("from_s", 0.0):
            raise self._wrong("until_s", "must be later than from_s", self._raw["until_s"])
        return Fault(self._kind, **values)

    def _allowed(self) -> list[str]:
        """Return the keys that an entry of this kind may have."""
        kind = self._kind
        servos = [] if kind in ON_INSTRUCTIONS or kind == "unplug" else ["servos"]
        when = ["probability"] if self._by_chance else ["at_s", "every_s"]
        lasts = ["lasts_s"] if kind in LASTING else []
        amount = ["amount"] if kind in AMOUNTS else []
        return ["kind", *servos, *when, "from_s", "until_s", *lasts, *amount]

    def _check_times(self) -> None:
        if "at_s" not in self._raw and "every_s" not in self._raw:
            raise FaultScriptError(f"{self._where}: this fault never happens; give at_s or every_s")
        for key in ("from_s", "until_s"):
            if key in self._raw and "every_s" not in self._raw:
                raise FaultScriptError(f"{self._where}: {key} needs every_s; add it")

    def _numbers(self, key: str, bounds: Bounds) -> tuple[float, ...]:
        """Return the value of `key`, a number or a list, as numbers. Raises FaultScriptError."""
        value = self._raw[key]
        several = value if isinstance(value, list) else [value]
        if not several:
            raise self._wrong(key, "must not be empty; leave it out", value)
        return tuple(self._number(key, each, bounds) for each in several)

    def _number(self, key: str, value: object, bounds: Bounds) -> float:
        """Return `value` if it is a number within `bounds`; raise FaultScriptError otherwise."""
        low, high = bounds.low, bounds.high
        kind = "a whole number" if bounds.whole else "a number"
        span = f"from {low:g} on" if high == _LONGEST_S else f"between {low:g} and {high:g}"
        meaning = f" ({bounds.meaning})" if bounds.meaning else ""
        allowed = f"must be {kind} {span}{meaning}"
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(key, allowed, value)
        if (bounds.whole and not isinstance(value, int)) or not low <= value <= high:
            raise self._wrong(key, allowed, value)
        return value

    def _wrong(self, key: str, allowed: str, value: object) -> FaultScriptError:
        where = f"{self._where}: {key}" if key else self._where
        return FaultScriptError(f"{where}: {allowed}, found {_shown(value)}")


def _shown(value: object) -> str:
    """Return a value from a script as short text for an error message."""
    if value is None:
        return "nothing"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, str):
        short = repr(value if len(value) <= 40 else value[:37] + "...")
        try:
            return f"{short} (YAML takes this for text; write {float(value):g})"
        except ValueError:
            return short
    if isinstance(value, int) and value.bit_length() > 128:
        return "a number of many digits"
    return str(value)
