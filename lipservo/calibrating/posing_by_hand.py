"""Posing with the fingers: encoders are read live, a key keeps the pose that the hands hold."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from calibration.mouth_servos import MouthServos
from firmware_bridge.stopping import named_by_reason
from lipservo.calibrating.hand_poses import HandPose, beyond_limits
from lipservo.face.limp_servos import LOOK_EVERY_S, LimpPose, LimpServos
from lipsync.arrays import Array

_KEEP, _LEAVE_OUT, _BACK, _STOP = (" ", "\n", "\r"), "x", "b", "q"
_KEYS = "space or Enter: keep   x: leave this pose out   b: back   q: stop"
_BAR = 31


class Keys(Protocol):
    """Single keys of a person or a script."""

    def next_key(self, timeout_s: float) -> str | None:
        """The next key, or None after so long."""


@dataclass(slots=True)
class Posing:
    """Where a person is, and what was made: angles (n_servos,) by the name of the pose.

    keep: told of all that was made after each pose. undivided: what happens in it is not broken
    off by a signal.
    """

    poses: Sequence[HandPose]
    made_deg: dict[str, Array]
    keep: Callable[[Mapping[str, Array]], None]
    undivided: Callable[[], AbstractContextManager[object]]
    note: str = ""
    current: int = field(init=False)

    def __post_init__(self) -> None:
        """Begin with the first that was not made in an earlier session."""
        names = [pose.name for pose in self.poses]
        self.current = next((n for n, name in enumerate(names) if name not in self.made_deg), 0)


def pose_by_hand(
    servos: LimpServos, mouth: MouthServos, posing: Posing, keys: Keys, console: Console
) -> Mapping[str, Array]:
    """Let a person make the poses; what was made, once all are or the person stops.

    The servos are limp already. Raises PortGone.
    """
    with Live(console=console, transient=True, auto_refresh=False) as live:
        while posing.current < len(posing.poses):
            with posing.undivided():
                seen = servos.look()
            live.update(_page(posing, mouth, seen), refresh=True)
            key = keys.next_key(LOOK_EVERY_S)
            if key is None:
                continue
            posing.note = ""
            if key == _STOP:
                break
            if key in _KEEP:
                with posing.undivided():
                    _keep(servos, mouth, posing)
                if posing.note:
                    console.print(posing.note, soft_wrap=True, highlight=False)
            elif key == _LEAVE_OUT:
                posing.current += 1
            elif key == _BACK:
                posing.current = max(0, posing.current - 1)
    return posing.made_deg


def _keep(servos: LimpServos, mouth: MouthServos, posing: Posing) -> None:
    """Keep the pose that is held, or note why not."""
    held = servos.steady_pose()
    obstacles = held.obstacles | beyond_limits(mouth, held.positions_deg)
    name = posing.poses[posing.current].name
    if obstacles:
        posing.note = f"{name} is not kept: {named_by_reason(obstacles)}"
        return
    posing.made_deg[name] = held.positions_deg
    posing.keep(posing.made_deg)
    posing.current += 1


def _page(posing: Posing, mouth: MouthServos, seen: LimpPose) -> RenderableType:
    pose = posing.poses[posing.current]
    table = Table.grid(padding=(0, 2))
    outside = beyond_limits(mouth, seen.positions_deg)
    for n, joint in enumerate(mouth.joints):
        here_deg = float(seen.positions_deg[n])
        why = seen.obstacles.get(joint.name, "outside its limits" if joint.name in outside else "")
        bar = _bar(here_deg, joint.min_deg, joint.max_deg)
        table.add_row(joint.name, f"{here_deg:7.1f} deg", bar, Text(why, style="bold yellow"))
    title = f"{posing.current + 1} of {len(posing.poses)}, {pose.name}: {pose.instruction}"
    return Group(
        Text(title, style="bold"), table, Text(posing.note, style="yellow"), Text(_KEYS, "dim")
    )


def _bar(here_deg: float, min_deg: float, max_deg: float) -> str:
    """Where a joint is between its limits, in characters that every terminal has."""
    if not np.isfinite(here_deg) or max_deg <= min_deg:
        return "." * _BAR
    share = (here_deg - min_deg) / (max_deg - min_deg)
    place = round(float(np.clip(share, 0.0, 1.0)) * (_BAR - 1))
    return "." * place + "o" + "." * (_BAR - 1 - place)
