"""The setup of a calibration: the robot's face, the recorded speaker's model, options, servos."""

import datetime
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from calibration.capture.capture import LEAD_IN_DEG, KeptPoses
from calibration.fit.procedure import Procedure, machine_poses
from calibration.mouth_servos import JointRange, MouthServos
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.clock import MonotonicClock
from lipservo.runtime.servos.assembly import mouth_rules
from lipservo.runtime.servos.held_face import SPEED_DEG_S, HeldFace
from lipservo.settings.settings import FaceSettings
from lipservo.terminal.output import MESSAGES
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array

#: Neutral, each of ten joints alone from both sides, and as many again spread over the range and
#: over speech: docs/benchmarks.md has the errors for this number.
N_POSES = 60
#: Seconds until servos are still after a move, and that a joint chirps.
_SETTLES_S: Final = 0.4
CHIRPS_S: Final = 14.0
#: Keys of a servo that say, with a joint's angle, which servo turns to where; not all have all.
_MOUNTING: Final = ("address", "sign", "zero_offset_deg", "us_per_deg", "neutral_us")
#: What is seen from the side alone.
_FORWARD_WORDS = ("protrudes", "retracts")


@dataclass(frozen=True, slots=True)
class Watch:
    """Callbacks that follow a calibration besides the terminal; by default they do nothing.

    progress: called with the name of the step, the number done, and the number in all, which may be
    exceeded. arrived: called with the mouth's encoder positions, (n_servos,) degrees. seen: called
    with the markers' names and positions, (n_markers, 3) mm.
    """

    progress: Callable[[str, int, int], object] = lambda *_: None
    arrived: Callable[[Array], object] = lambda _: None
    seen: Callable[[tuple[str, ...], Array], object] = lambda *_: None


@dataclass(frozen=True, slots=True)
class CalibrationSetup:
    """The face and options of a calibration, for every sub-command that makes one.

    model: of the recorded speaker's face. keep: the file that receives every captured pose; quiet:
    no progress bar; lags: whether the servos' delays behind their goals are measured, by chirps and
    steps; speed_deg_s: speed of servos from pose to pose.
    sees_forward: whether markers are measured in depth too. accept: doubts about joints, size and
    grade only warn. config: the face's name for a page that shows its servos; None: no page.
    """

    settings: FaceSettings
    model: FaceWithAnimPhos
    n_poses: int = N_POSES
    keep: Path | None = None
    quiet: bool = False
    lags: bool = True
    speed_deg_s: float = SPEED_DEG_S
    sees_forward: bool = True
    accept: bool = False
    config: str | None = None
    watch: Watch = field(default_factory=Watch)

    @property
    def servos(self) -> MouthServos:
        """The mouth's servos in the form that the fits of a calibration need.

        A joint's word for its positive angle is empty if the tracker cannot see that motion.
        """
        mouth = self.settings.mouth_servos
        return MouthServos(
            joints=tuple(JointRange(n, s.min_deg, s.max_deg) for n, s in mouth.items()),
            face_checksum=self.settings.checksum,
            models=tuple(servo.make or "" for servo in mouth.values()),
            positive=tuple(self._visible_word(servo.positive) for servo in mouth.values()),
            rules=mouth_rules(self.settings),
        )

    def for_machine(self) -> "CalibrationSetup":
        """Return the setup with as many poses as a machine takes for this face's joints."""
        return replace(self, n_poses=machine_poses(self.n_poses, len(self.servos.joints)))

    @property
    def estimated_poses(self) -> int:
        """How many poses `measure` takes if no joint is in doubt and lips meet early."""
        return self.n_poses + self.procedure().n_usual_more

    @property
    def pose_s(self) -> float:
        """Seconds that the servos need for a pose, without the tracker's."""
        plan = self.procedure().range_plan()
        turns_deg = np.abs(np.diff(plan.goals_deg, axis=0)).max(axis=1)
        return (float(turns_deg.mean()) + LEAD_IN_DEG) / self.speed_deg_s + 2 * _SETTLES_S

    @property
    def chirps_s(self) -> float:
        """Seconds of the chirps and steps by which lags are measured."""
        return CHIRPS_S * len(self.servos.joints) if self.lags and self.has_place else 0.0

    @property
    def kept(self) -> KeptPoses:
        """The file `keep`; poses in it of servos that were mounted otherwise are refused."""
        servos = self.settings.mouth_servos.values()
        mounting = [[getattr(servo, key, None) for key in _MOUNTING] for servo in servos]
        return KeptPoses(self.keep, mounting=json.dumps(mounting))

    @property
    def has_place(self) -> bool:
        """Whether every servo of the mouth reports its position; else goals count as positions."""
        return all(can.place for can in self._mouth_buses)

    @property
    def has_any_place(self) -> bool:
        """Whether any servo of the mouth reports its position."""
        return any(can.place for can in self._mouth_buses)

    @property
    def has_load(self) -> bool:
        """Whether every servo of the mouth reports its load."""
        return all(can.load for can in self._mouth_buses)

    @property
    def _mouth_buses(self) -> list[BusCapabilities]:
        return [one.capabilities for one in self.settings.alone.values() if one.mouth_servos]

    def _visible_word(self, positive: str) -> str:
        """Return `positive`, what a positive angle does; empty if the tracker cannot see that."""
        return positive if self.sees_forward or positive not in _FORWARD_WORDS else ""

    def procedure(self, seed: int = 0) -> Procedure:
        """Return the capture procedure for this face; `seed` draws its poses."""
        face, n = self.servos, self.n_poses
        return Procedure(self.model, face.joints, n, face.rules, seed, face.positive, self.accept)


def today() -> str:
    """Return the present date, ISO 8601, with which a new calibration is dated."""
    return datetime.date.today().isoformat()


def held_servos(setup: CalibrationSetup) -> HeldFace:
    """Return the face's own servos, which a `with` block moves to neutral and holds to its end."""
    clock = MonotonicClock()
    return HeldFace(setup.settings, clock, speed_deg_s=setup.speed_deg_s, config=setup.config)


@contextmanager
def progress_bar(setup: CalibrationSetup, what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar, labelled `what`, with the time left; yield a function that sets it.

    The function is called with the number done. More than `total` may be done, as when a
    joint is measured again: the bar's total then grows.
    """
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=MESSAGES,
        transient=True,
        disable=setup.quiet,
    ) as bar:
        task = bar.add_task(what, total=total)

        def tell(done: int) -> None:
            bar.update(task, completed=done, total=max(total, done))
            setup.watch.progress(what, done, total)

        setup.watch.progress(what, 0, total)
        yield tell
