"""`lipservo bench calibration`: every robot of a run, on all cores, and what is counted of them.

A robot is a task of its own, and says in the end what became of it: its score, or why it was
refused. So a run ends with figures whatever becomes of single robots.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from functools import cache
from multiprocessing import get_context
from typing import TypeVar

from threadpoolctl import threadpool_limits

from calibration.calibration import CalibrationError
from calibration.simulated.robot_family import RobotFamily
from lipservo_lab.bench.calibration.attitude_figures import (
    AskewRobot,
    askew_robot,
    attitude_figures,
)
from lipservo_lab.bench.calibration.calibration_figures import OwnRobot, own_figures, own_robot
from lipservo_lab.bench.calibration.closing_figures import (
    N_OPEN_MOUTHS,
    TriedMouth,
    closing_figures,
    tried_mouth,
)
from lipservo_lab.bench.calibration.elastic_figures import (
    ElasticRobot,
    elastic_figures,
    elastic_robot,
)
from lipservo_lab.bench.calibration.hard_captures import fault_figures
from lipservo_lab.bench.calibration.killed_captures import killed_captures, resumed_figures
from lipservo_lab.bench.calibration.shipped_ways import hobby_over_positions, way_figures
from lipservo_lab.bench.calibration.unit_figures import UnitErrors, unit_errors, unit_figures
from lipservo_lab.worker_pool import worker_pool
from lipsync.animpho.units import FaceWithAnimPhos, load_face_with_animphos

_Robot = OwnRobot | ElasticRobot | AskewRobot | TriedMouth | UnitErrors
_Outcome = _Robot | dict[str, dict[str, float | str]]
_Task = Callable[[FaceWithAnimPhos, int], _Outcome]
_Kept = TypeVar("_Kept")


def read_seeds(text: str) -> list[int]:
    """Return the seeds of a text such as `3` or `0-19`. Raises CalibrationError for other texts."""
    parts = text.split("-")
    if len(parts) > 2 or not all(part.isdecimal() for part in parts):
        raise CalibrationError(f"--seeds {text}: expected one number or a range such as 0-19")
    seeds = list(range(int(parts[0]), int(parts[-1]) + 1))
    if not seeds:
        raise CalibrationError(f"--seeds {text}: the first is larger than the last")
    return seeds


def bench_figures(
    seeds: Sequence[int],
    families: Sequence[RobotFamily],
    *,
    ways: bool = False,
    kills: int = 0,
    advance: Callable[[int, int], None] = lambda _, __: None,
) -> dict[str, object]:
    """Run all tasks of `bench calibration`; return their figures.

    Healthy robots of each seed and family, robots with faults or seen askew, mouths that cannot
    close. With
    both families, the figures of the second are in `elastic`, but `refused`, `faults_named` and
    `faults_misnamed` count both. ways: also calibrate the first seed's robots in every shipped way.
    kills: also kill and resume so many captures with each of three trackers. advance: called with
    tasks done and all tasks.
    """
    task_of_family: Mapping[RobotFamily, _Task] = {
        RobotFamily.OWN: own_robot,
        RobotFamily.ELASTIC: elastic_robot,
    }
    tasks = [(task_of_family[family], seed) for seed in seeds for family in families]
    tasks += [(tried_mouth, seed) for seed in range(N_OPEN_MOUTHS)]
    if RobotFamily.ELASTIC in families:
        tasks += [(task, seed) for seed in seeds for task in (unit_errors, askew_robot)]
    tasks += [(way_figures, seeds[0])] if ways else []
    outcomes = _worked_off(tasks, advance)
    own, elastic = _outcomes_of(OwnRobot, outcomes), _outcomes_of(ElasticRobot, outcomes)
    figures: dict[str, object] = {"family": "+".join(families)}
    family_figures = [own_figures(own)] if RobotFamily.OWN in families else []
    if RobotFamily.ELASTIC in families:
        family_figures.append(elastic_figures(elastic))
    figures |= family_figures[0]
    if len(family_figures) > 1:
        figures["elastic"] = family_figures[1]
        figures |= fault_figures([robot.faults for robot in own] + [r.faults for r in elastic])
        figures["refused"] = sum(int(str(each["refused"])) for each in family_figures)
    if askew := _outcomes_of(AskewRobot, outcomes):
        figures |= attitude_figures(askew, elastic)
    if sisters := _outcomes_of(UnitErrors, outcomes):
        figures |= unit_figures(sisters)
    figures |= closing_figures(_outcomes_of(TriedMouth, outcomes))
    if ways:
        figures["ways"] = way_errors = outcomes[-1]
        assert isinstance(way_errors, dict)
        figures["hobby_over_positions"] = hobby_over_positions(way_errors)
    if kills:
        figures |= resumed_figures(killed_captures(_model(), seeds[0], kills))
    return figures


def _outcomes_of(kind: type[_Kept], outcomes: Sequence[object]) -> list[_Kept]:
    """Return the outcomes of one class, in their order."""
    return [outcome for outcome in outcomes if isinstance(outcome, kind)]


def _worked_off(
    tasks: Sequence[tuple[_Task, int]], advance: Callable[[int, int], None]
) -> list[_Outcome]:
    """Run the tasks with a process for each core; return the outcomes in the order of the tasks.

    Each process computes in one thread: the matrix products are too small for more.
    """
    advance(0, len(tasks))
    n_workers = min(len(tasks), len(os.sched_getaffinity(0)))
    with worker_pool(n_workers, get_context("spawn")) as pool:
        futures = [pool.submit(_run_single_threaded, task, seed) for task, seed in tasks]
        try:
            for n_done, _ in enumerate(as_completed(futures), start=1):
                advance(n_done, len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [future.result() for future in futures]


def _run_single_threaded(task: _Task, seed: int) -> _Outcome:
    with threadpool_limits(limits=1):
        return task(_model(), seed)


@cache
def _model() -> FaceWithAnimPhos:
    return load_face_with_animphos()
