"""Fault scripts and the log of pulses, common to simulated controllers of hobby servos.

Servos that report their positions have `fault_script` and `faults`.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import ValidationError, create_model

from firmware_bridge.bus_settings import Strict, within
from firmware_bridge.errors import ServoError


class TimedFault(Strict):
    """A fault of a simulated controller: at at_s, and then every `every_s` (None: once).

    lasts_s: the duration of faults that last.
    """

    at_s: Annotated[float, within(0.0, 1e9)]
    every_s: Annotated[float, within(0.01, 1e9)] | None = None
    lasts_s: Annotated[float, within(0.001, 1e9)] = 0.5


Fault = TypeVar("Fault", bound=TimedFault)


def parse_faults(text: str | None, fault: type[Fault]) -> Sequence[Fault]:
    """Return the faults in the YAML script `text`, as objects of the class `fault`; none for None.

    Raises ValueError for a bad script.
    """
    if text is None:
        return ()
    script: type[Any] = create_model("Script", __base__=Strict, faults=(list[fault], ...))  # type: ignore[valid-type]
    try:
        faults: list[Fault] = script.model_validate(yaml.safe_load(text)).faults
    except yaml.YAMLError as error:
        raise ValueError("not YAML") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    return faults


def pulse_log(path: Path | None) -> Callable[[Sequence[float]], None] | None:
    """Return a function that writes a row of numbers to `path` as a line of JSON.

    None if `path` is None. Raises ServoError where the file cannot be written.
    """
    if path is None:
        return None
    try:
        file = path.open("w", buffering=1, encoding="utf-8")
    except OSError as error:
        raise ServoError(f"--log {path}: cannot be written: {error.strerror}") from error

    def write(row: Sequence[float]) -> None:
        file.write(json.dumps(row) + "\n")

    return write
