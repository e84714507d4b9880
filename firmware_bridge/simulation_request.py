"""The request for a simulator at a port: servos, a fault script, a log.

Dynamixels have a language of faults of their own: `fault_script` and `faults`.
"""

import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

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
Model = TypeVar("Model")


@dataclass(frozen=True, slots=True)
class SimulationRequest:
    """A request for simulated servos at a port of their own.

    n_servos, first_id: how many, and the first one's id, where they belong to no face. model: None:
    the usual one. baud_rate: None: that of the face, or the factory's. faults: the YAML text of a
    script. log: a file for what they do. chain_stops: servos behind a silent one do not answer.
    """

    n_servos: int = 1
    first_id: int = 1
    model: str | None = None
    baud_rate: int | None = None
    faults: str | None = None
    log: Path | None = None
    chain_stops: bool = False

    def new_servos(
        self, models: Mapping[str, Model], usual: str, rates: Collection[int], highest_id: int
    ) -> tuple[list[Model], range]:
        """Return models and ids of the servos requested, where they belong to no face.

        models: all that can be simulated, by name. usual: the name used where the request has no
        model. rates: all baud rates. Raises ServoError for an unknown model or rate, or an id above
        highest_id.
        """
        last_id, model = self.first_id + self.n_servos - 1, self.model or usual
        if model not in models:
            raise ServoError(f"servo model {model!r} is not known; use one of {', '.join(models)}")
        if self.baud_rate is not None and self.baud_rate not in rates:
            raise ServoError(f"these servos have no baud rate {self.baud_rate}")
        if last_id > highest_id:
            ids = f"ids {self.first_id}..{last_id}"
            raise ServoError(f"servo ids {ids}: the highest possible id is {highest_id}")
        return [models[model]] * self.n_servos, range(self.first_id, last_id + 1)

    def timed_faults(self, fault: type[Fault]) -> Sequence[Fault]:
        """Return the faults of the script, as objects of the class `fault`. Raises ValueError."""
        return parse_faults(self.faults, fault)

    def row_log(self) -> Callable[[Sequence[float]], None]:
        """Return a function that writes a row of numbers to the log, if any, as a line of JSON.

        Raises ServoError where the file cannot be written.
        """
        if self.log is None:
            return lambda _row: None
        try:
            file = self.log.open("w", buffering=1, encoding="utf-8")
        except OSError as error:
            raise ServoError(f"--log {self.log}: cannot be written: {error.strerror}") from error

        def write(row: Sequence[float]) -> None:
            file.write(json.dumps(row) + "\n")

        return write


class DueFaults(Generic[Fault]):
    """The faults of a script that are still to happen."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self._coming = [(fault.at_s, fault) for fault in faults]

    def take(self, now_s: float) -> list[tuple[float, Fault]]:
        """Return (time, fault) of the faults that begin by `now_s`, in order of time.

        A fault is returned once a call at most; one that is repeated is due again `every_s` later.
        """
        due = [each for each in self._coming if each[0] <= now_s]
        for at_s, fault in due:
            self._coming.remove((at_s, fault))
            if fault.every_s is not None:
                self._coming.append((at_s + fault.every_s, fault))
        return sorted(due, key=lambda each: each[0])


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
        raise ValueError("the fault script is not YAML") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    return faults
