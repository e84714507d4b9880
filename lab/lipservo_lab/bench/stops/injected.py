"""Troubles put into every Python process of a face, from outside the product's code.

A campaign copies this file as `sitecustomize.py` into a folder on `PYTHONPATH`; the interpreter
imports it before anything else. A trouble is on while a file of its name lies in the folder that
`LIPSERVO_BENCH_FOLDER` names. The first time that it takes effect, `seen.NAME` is written there.

name_service: look-ups of users and groups take 4 s. disk: so does each fsync. status_raises,
status_hangs: the function that makes the whole status; it hangs only in the process that owns the
servos, which a supervisor can end. clock: `time.time` and `time.time_ns` jump by a day, there and
back, every half second; what C code reads of the clock does not.
"""

import grp
import importlib.abc
import importlib.machinery
import os
import pwd
import sys
import time
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

SLOW_S = 4.0
JUMP_S = 86_400.0
FOLDER_VARIABLE = "LIPSERVO_BENCH_FOLDER"
#: (module, function) of what makes the whole status; a test holds that they exist.
STATUS_MAKERS = (("lipservo.runtime.status.face_status", "whole_status"),)
LOOK_UPS = (
    (pwd, ("getpwuid", "getpwnam", "getpwall")),
    (grp, ("getgrgid", "getgrnam", "getgrall")),
)
_HANGS_IN = "bridge-process"


class Troubles:
    """Which troubles are on, switched by files."""

    def __init__(self, folder: str, sleep: Callable[[float], None] = time.sleep) -> None:
        self._folder = folder
        self._sleep = sleep

    def is_on(self, name: str) -> bool:
        """Return whether a trouble's flag file exists; write `seen.NAME` the first time it does."""
        if not os.path.exists(os.path.join(self._folder, name)):
            return False
        mark = os.path.join(self._folder, f"seen.{name}")
        if not os.path.exists(mark):
            with open(mark, "w", encoding="ascii"):
                pass
        return True

    def delayed(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        """Return the function delayed by `SLOW_S` while the trouble `name` is on.

        Other threads run meanwhile.
        """

        def delayed_function(*arguments: Any, **named: Any) -> Any:
            if self.is_on(name):
                self._sleep(SLOW_S)
            return function(*arguments, **named)

        return delayed_function

    def failing(self, function: Callable[..., Any], *, may_hang: bool) -> Callable[..., Any]:
        """Wrap `function` so that it raises while the fault `status_raises` is on.

        may_hang: the function also does not return while `status_hangs` is on.
        """

        def failing_function(*arguments: Any, **named: Any) -> Any:
            if self.is_on("status_raises"):
                raise RuntimeError("injected: no status can be made")
            while may_hang and self.is_on("status_hangs"):
                self._sleep(0.1)
            return function(*arguments, **named)

        return failing_function

    def jumping(self, clock: Callable[[], Any], unit: int) -> Callable[[], Any]:
        """Wrap a clock so that it is a day ahead in every other half second.

        unit: the clock's steps in a second.
        """

        def jumping_clock() -> Any:
            is_ahead = self.is_on("clock") and int(time.monotonic() * 2.0) % 2 == 0
            return clock() + type(clock())(JUMP_S * unit) if is_ahead else clock()

        return jumping_clock


class _PatchedLoader(importlib.abc.Loader):
    """Loads a module, then wraps some functions of it before another module can import them."""

    def __init__(self, loader: importlib.abc.Loader, wrap: Callable[[ModuleType], None]) -> None:
        self._loader = loader
        self._wrap = wrap

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        self._wrap(module)


class PatchingFinder(importlib.abc.MetaPathFinder):
    """Finds the modules whose functions are wrapped. wraps: by the module's name."""

    def __init__(self, wraps: dict[str, Callable[[ModuleType], None]]) -> None:
        self._wraps = wraps

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return the ordinary spec with a loader that wraps; None for modules not in `wraps`."""
        wrap = self._wraps.get(name)
        if wrap is None:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = _PatchedLoader(spec.loader, wrap)
        return spec


def install(folder: str) -> None:
    """Patch this process: name look-ups and disk get slow, clocks jump, status fails, by flags.

    Each trouble is on while its flag file exists in `folder`.
    """
    troubles = Troubles(folder)
    for module, names in LOOK_UPS:
        for name in names:
            setattr(module, name, troubles.delayed(getattr(module, name), "name_service"))
    for name in ("fsync", "fdatasync"):
        setattr(os, name, troubles.delayed(getattr(os, name), "disk"))
    time.time = troubles.jumping(time.time, 1)
    time.time_ns = troubles.jumping(time.time_ns, 10**9)
    may_hang = _HANGS_IN in sys.orig_argv
    wraps: dict[str, Callable[[ModuleType], None]] = {}
    for place, name in STATUS_MAKERS:

        def wrap(module: ModuleType, name: str = name) -> None:
            setattr(module, name, troubles.failing(getattr(module, name), may_hang=may_hang))

        wraps[place] = wrap
    sys.meta_path.insert(0, PatchingFinder(wraps))


if FOLDER_VARIABLE in os.environ:
    install(os.environ[FOLDER_VARIABLE])
