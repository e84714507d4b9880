"""The two families of simulated robots."""

from enum import StrEnum


class RobotFamily(StrEnum):
    """own: rubber and play (face.py, robot.py); elastic: lips that stop each other, and more."""

    OWN = "own"
    ELASTIC = "elastic"
