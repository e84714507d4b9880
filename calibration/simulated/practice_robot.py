"""A robot to practise on, whatever a face calls its joints. Loads SciPy for elastic ones."""

from collections.abc import Callable, Sequence

from calibration.calibration import CalibrationError
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_family import elastic_robot_of, pulls_of
from calibration.simulated.elastic_robot import ElasticFace
from calibration.simulated.face import POSITIVE_DIRECTIONS, marker_positions_mm, simulated_face
from calibration.simulated.robot import SimulatedRobot, draw_robot
from calibration.simulated.robot_family import RobotFamily
from lipsync.arrays import Array

#: The elastic robot that a face stands for where none is asked for by number.
USUAL_SEED = 1


def family_of(servos: MouthServos) -> RobotFamily:
    """The simulated face where it has all these joints, by name; else an elastic robot."""
    known = all(name in POSITIVE_DIRECTIONS for name in servos.names)
    return RobotFamily.OWN if known else RobotFamily.ELASTIC


def practice_robot(
    rest_mm: Array, servos: MouthServos, seed: int, family: RobotFamily | None = None
) -> SimulatedRobot:
    """Make the robot of a seed that has the joints of this face.

    Parameters
    ----------
    rest_mm : Array
        (47, 3), a closed mouth.
    servos : MouthServos
        Of the face.
    seed : int
        Of the draw.
    family : RobotFamily | None
        None for `family_of`.

    Returns
    -------
    SimulatedRobot
        Measures in mm.

    Raises
    ------
    CalibrationError
        There are no joints, or the family does not know them.
    """
    _check_joints(servos)
    if (family or family_of(servos)) is RobotFamily.ELASTIC:
        return SimulatedRobot(ElasticFace(elastic_robot_of(rest_mm, servos, seed)), noise_seed=seed)
    try:
        return SimulatedRobot(draw_robot(rest_mm, servos.names, seed), noise_seed=seed)
    except ValueError as error:
        raise CalibrationError(f"{error}; --family elastic takes joints of any names") from error


def markers_of_face(rest_mm: Array, servos: MouthServos) -> Callable[[Array], Array]:
    """Return the exact model of a robot with the joints of this face.

    Parameters
    ----------
    rest_mm : Array
        (47, 3), a closed mouth.
    servos : MouthServos
        Of the face.

    Returns
    -------
    Callable[[Array], Array]
        (n, n_servos) joint degrees to (n, 47, 3) mm.

    Raises
    ------
    CalibrationError
        There are no joints.
    """
    _check_joints(servos)
    if family_of(servos) is RobotFamily.ELASTIC:
        return ElasticFace(elastic_robot_of(rest_mm, servos, USUAL_SEED)).markers_mm
    face = simulated_face(rest_mm, servos.names)
    return lambda positions_deg: marker_positions_mm(face, positions_deg)


def guessed_joints(servos: MouthServos, family: RobotFamily | None = None) -> Sequence[str]:
    """Joints of which neither name nor word says what they move: a simulated robot guesses."""
    if (family or family_of(servos)) is RobotFamily.OWN:
        return ()
    pulls = pulls_of(servos.names, servos.positive)
    return [n for n, pull in zip(servos.names, pulls, strict=True) if pull.is_guess]


def _check_joints(servos: MouthServos) -> None:
    if not servos.joints:
        raise CalibrationError(
            "the face has no servo of `part: mouth`, so there is nothing to calibrate"
        )
