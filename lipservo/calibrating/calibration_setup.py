"""What a calibration is made of: the face, the speaker's model, and how servos are moved for it."""

import datetime
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from calibration.calibration import CalibrationError
from calibration.capture.capture import least_poses
from calibration.fit.procedure import Procedure
from calibration.mouth_servos import JointRange, MouthServos
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
#: What a person has the patience to measure by hand, at five markers each.
_N_TYPED_POSES = 24
#: What is seen from the side alone.
_FORWARD_WORDS = ("protrudes", "retracts")


@dataclass(frozen=True, slots=True)
class Watch:
    """Callbacks that follow a calibration besides the terminal; by default they do nothing.

    progress: what is done, how many of it, of how many; more may be. arrived: where the mouth's
    encoders stand, (n_servos,). seen: the markers' names, and their places there, (n_markers, 3).
    """

    progress: Callable[[str, int, int], object] = lambda *_: None
    arrived: Callable[[Array], object] = lambda _: None
    seen: Callable[[tuple[str, ...], Array], object] = lambda *_: None


@dataclass(frozen=True, slots=True)
class CalibrationSetup:
    """The same for every sub-command that makes a calibration.

    keep: the file that holds every captured pose; quiet: no progress bar; lags: whether servos are
    moved by chirps and steps; speed_deg_s: how fast servos are moved from pose to pose.
    sees_forward: whether markers are measured in depth too. accept: what is judgement, of joints,
    size and grade, only warns. config: of the face, for a page that watches its servos; None: none.
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
        """The mouth's servos, as the fits want them."""
        mouth = self.settings.mouth_servos
        return MouthServos(
            joints=tuple(JointRange(n, s.min_deg, s.max_deg) for n, s in mouth.items()),
            face_checksum=self.settings.checksum,
            models=tuple(servo.make or "" for servo in mouth.values()),
            positive=tuple(self._word(servo.positive) for servo in mouth.values()),
            rules=mouth_rules(self.settings),
        )

    @property
    def n_typed_poses(self) -> int:
        """How many poses there are where a person types what each marker is."""
        return max(_N_TYPED_POSES, least_poses(len(self.servos.joints)))

    def _word(self, positive: str) -> str:
        """What a positive angle does; empty where the tracker cannot see whether it does."""
        return positive if self.sees_forward or positive not in _FORWARD_WORDS else ""

    def procedure(self, seed: int = 0) -> Procedure:
        """The capture procedure of this face."""
        servos = self.servos
        return Procedure(
            self.model,
            servos.joints,
            self.n_poses,
            servos.rules,
            seed,
            servos.positive,
            self.accept,
        )


def today() -> str:
    """The date that a calibration made now carries, ISO 8601."""
    return datetime.date.today().isoformat()


def check_places(settings: FaceSettings) -> None:
    """Raises CalibrationError where servos cannot say where they stand."""
    for one in settings.alone.values():
        if one.mouth_servos and not one.capabilities.place:
            raise CalibrationError(
                f"{settings.name}: servos on a {one.bus.kind} bus cannot say where they stand, "
                "which this way of calibrating measures"
            )


def held_servos(setup: CalibrationSetup) -> HeldFace:
    """The face's own servos, in neutral and held until the block ends."""
    check_places(setup.settings)
    clock = MonotonicClock()
    return HeldFace(setup.settings, clock, speed_deg_s=setup.speed_deg_s, config=setup.config)


@contextmanager
def progress_bar(setup: CalibrationSetup, what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A progress bar with the time left; what it yields is called with the number done.

    More than `total` may be done: a joint may need a second look.
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
