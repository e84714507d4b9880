"""Options that several sub-commands of `calibrate` share."""

from pathlib import Path
from typing import Annotated

import typer

Output = Annotated[Path, typer.Option("--output", "-o", help="The calibration to write.")]
Markers = Annotated[
    Path | None,
    typer.Option(
        help="Markers recorded at the poses of a plan: CSV, JSON, a folder of C3D or of pictures.",
        show_default=False,
    ),
]
Axes = Annotated[
    str, typer.Option(help="Axes of C3D files that point to the robot's left, up and forward.")
]
Poses = Annotated[int, typer.Option(help="How many poses are captured.")]
Keep = Annotated[
    Path | None,
    typer.Option(
        help="Keep every captured pose in this file at once; go on from it.", show_default=False
    ),
]
Lags = Annotated[bool, typer.Option(help="Find the servos' lags too, by chirps and steps.")]
Speed = Annotated[
    float,
    typer.Option(min=5.0, max=400.0, help="Servos move from pose to pose so fast, degrees/s."),
]
Ranges = Annotated[
    Path | None,
    typer.Option(help="LeRobot range file that the limits must lie within.", show_default=False),
]
Plots = Annotated[
    Path | None,
    typer.Option(help="Folder for a picture of what is within reach.", show_default=False),
]
Landmarker = Annotated[
    Path | None,
    typer.Option(
        help="A face_landmarker.task (docs/own-face.md); default: mediapipe's own face mesh.",
        show_default=False,
    ),
]
EyeDistance = Annotated[
    float | None,
    typer.Option(
        min=10.0,
        max=500.0,
        help="Between the outer corners of the robot's eyes; default: of the face's YAML.",
        show_default=False,
    ),
]
Camera = Annotated[
    str, typer.Option(help="With --tracker camera: a number or a device; a video to try.")
]
CalibrationFile = Annotated[Path, typer.Argument(metavar="FILE", help="The calibration.")]
Accept = Annotated[
    bool,
    typer.Option(
        "--accept", help="Take what is judgement (odd joints, odd size, a bad grade) as a warning."
    ),
]
