"""Options of the commands that listen; apart from the others, since engines take long to load."""

from typing import Annotated

import typer

from lipservo.street.motion_options import Engine

EngineChoice = Annotated[
    Engine, typer.Option(help="Recogniser to begin with; a worse one takes over where it fails.")
]
WeightsChoice = Annotated[
    str, typer.Option(help="What the network has learned: default, grid, or a file of weights.")
]
