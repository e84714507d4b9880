"""The two families of simulated robots, as an enumeration."""

from enum import StrEnum


class RobotFamily(StrEnum):
    """A family of simulated robots: OWN (rubber skin, backlash) or ELASTIC (lips in contact).

    own: face.py, robot.py; elastic: elastic_robot.py.
    """

    OWN = "own"
    ELASTIC = "elastic"
