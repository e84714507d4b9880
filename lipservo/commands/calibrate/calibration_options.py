"""The options of `calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

Output = Annotated[
    Path | None,
    typer.Option("--output", "-o", help="The calibration to write.", show_default=False),
]
Plan = Annotated[
    Path | None,
    typer.Option(
        help="Poses (CSV). Without --markers: write them there, to move the robot through.",
        show_default=False,
    ),
]
Markers = Annotated[
    Path | None,
    typer.Option(
        help="Markers recorded at the poses of --plan: CSV, JSON, a folder of C3D or of pictures.",
        show_default=False,
    ),
]
Refine = Annotated[
    Path | None,
    typer.Option(
        help="With --plan and --markers: write a longer plan there, with poses of speech.",
        show_default=False,
    ),
]
Axes = Annotated[
    str, typer.Option(help="Axes of C3D files that point to the robot's left, up and forward.")
]
Port = Annotated[
    str | None,
    typer.Option(help="Move the servos at this port through the poses.", show_default=False),
]
Sim = Annotated[
    str | None,
    typer.Option(help="`pty`: simulated servos behind a port of their own.", show_default=False),
]
TrackerSource = Annotated[
    str | None,
    typer.Option(
        "--tracker",
        help="Who sees the markers: a .csv, .json or folder that is filled meanwhile, or `typed`.",
        show_default=False,
    ),
]
Practise = Annotated[
    int | None,
    typer.Option(
        metavar="SEED",
        help="Practise on a simulated robot drawn from a seed; with --sim pty over the wire.",
        show_default=False,
    ),
]
Guided = Annotated[
    bool,
    typer.Option("--guided", help="No tracker: put the mouth into named poses with keys, by eye."),
]
Keep = Annotated[
    Path | None,
    typer.Option(
        help="Keep every captured pose in this file at once; go on from it.", show_default=False
    ),
]
Lags = Annotated[
    bool, typer.Option(help="Find the servos' lags by chirps and steps, where servos move.")
]
Speed = Annotated[
    float, typer.Option(min=5.0, max=400.0, help="How fast servos are led, degrees a second.")
]
Ranges = Annotated[
    Path | None,
    typer.Option(help="LeRobot range file that the limits must lie within.", show_default=False),
]
Plots = Annotated[
    Path | None,
    typer.Option(help="Folder for a picture of what is within reach.", show_default=False),
]
