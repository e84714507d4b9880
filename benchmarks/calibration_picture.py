"""Draws docs/pictures/calibration.svg: what a calibrated simulated robot makes of six phonemes.

Run as `python benchmarks/calibration_picture.py docs/pictures/calibration.svg`.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.capture.capture import capture_poses, plan_poses
from calibration.fit.measured import fit_measured
from calibration.mouth_servos import JointRange, MouthServos
from calibration.run.compensation import BacklashCompensation
from calibration.simulated.robot import SimulatedRobot, draw_robot
from lipservo.settings.settings import load_shipped_face
from lipsync.animpho.units import load_face_with_animphos
from lipsync.markers import MARKERS_47

SEED = 100  # not among the seeds that are scored
SHOWN = ("M", "AA", "IY", "UW", "F", "AO")
CELL_PX, PX_PER_MM = 230, 3.0
LOOPS = tuple(
    [i for i, name in enumerate(MARKERS_47.names) if name.startswith(lip)]
    for lip in ("outer_lip", "inner_lip")
)


def loops(markers_mm: NDArray[np.float64], middle_mm: NDArray[np.float64], style: str) -> str:
    """Both lips of (47, 3) as SVG polygons around the origin."""
    polygons = []
    for loop in LOOPS:
        points = (markers_mm[loop, :2] - middle_mm) * [PX_PER_MM, -PX_PER_MM]
        polygons.append(
            f'<polygon points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}" {style}/>'
        )
    return "".join(polygons)


def main(path: Path) -> None:
    """Calibrate one robot and draw it."""
    model, mouth = load_face_with_animphos(), load_shipped_face("face_sim").mouth_servos
    joints = tuple(JointRange(n, s.min_deg, s.max_deg) for n, s in mouth.items())
    rest_mm = model.markers_mm(model.rest[None])
    draw = draw_robot(rest_mm[0], list(mouth), SEED)
    robot = SimulatedRobot(draw, noise_seed=SEED)
    capture = capture_poses(plan_poses(joints, 60), MARKERS_47.names, robot.move, robot.measure)
    fit = fit_measured(model, capture, MouthServos(joints))
    backlash = BacklashCompensation(fit.face.backlash_deg)
    middle_mm = draw.face.neutral_mm[LOOPS[0], :2].mean(axis=0) - [0.0, 6.0]
    cells = []
    for n, phoneme in enumerate(SHOWN):
        frames = model.animphos.samples[model.animphos.of_phoneme(phoneme), 2]
        frame = frames[np.abs(frames - np.median(frames, axis=0)).sum(axis=1).argmin()]
        robot.move(backlash.feed(fit.calibration.poses_deg(frame[None]))[0])
        copy_mm = draw.face.neutral_mm + fit.retargeting.scale * (
            model.markers_mm(frame[None]) - rest_mm
        )
        target_mm = fit.retargeting.targets_mm((frame - model.rest)[None])
        cells.append(
            f'<g transform="translate({CELL_PX * (n % 3 + 0.5)},{CELL_PX * (n // 3 + 0.5)})">'
            + loops(copy_mm[0], middle_mm, 'fill="none" stroke="#bbb" stroke-dasharray="4 3"')
            + loops(target_mm[0], middle_mm, 'fill="none" stroke="#36c" stroke-width="3"')
            + loops(robot.true_markers_mm(), middle_mm, 'fill="none" stroke="#c33"')
            + f'<text y="-80" text-anchor="middle" font-family="sans-serif">{phoneme}</text></g>'
        )
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {3 * CELL_PX} {2 * CELL_PX}">'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(cells)}</svg>\n'
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
