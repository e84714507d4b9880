"""A simulated robot to practise on, with a face's own joints. Loads SciPy for elastic ones."""

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
    """Return family OWN if the simulated face has joints of all these names; else ELASTIC."""
    return RobotFamily.OWN if {*servos.names} <= {*POSITIVE_DIRECTIONS} else RobotFamily.ELASTIC


def practice_robot(
    rest_mm: Array, servos: MouthServos, seed: int, family: RobotFamily | None = None
) -> SimulatedRobot:
    """Return the simulated robot, drawn from a seed, that has the joints of this face.

    Parameters
    ----------
    rest_mm : Array
        (47, 3) mm, markers of a closed mouth.
    servos : MouthServos
        Servos of the face.
    seed : int
        Seed of the draw, and of the tracker's noise.
    family : RobotFamily | None
        Family of the robot; None: chosen by the joints' names.

    Returns
    -------
    SimulatedRobot
        Robot that measures markers in mm.

    Raises
    ------
    CalibrationError
        There are no joints, or the family does not know them.
    """
    _check_joints(servos)
    if (family or family_of(servos)) is RobotFamily.ELASTIC:
        return SimulatedRobot(ElasticFace(elastic_robot_of(rest_mm, servos, seed)), noise_seed=seed)
    try:
        simulated_face(rest_mm, servos.names)
    except ValueError as error:
        raise CalibrationError(f"{error}; --family elastic accepts joints of any names") from error
    return SimulatedRobot(draw_robot(rest_mm, servos.names, seed), noise_seed=seed)


def markers_of_face(rest_mm: Array, servos: MouthServos) -> Callable[[Array], Array]:
    """Return the noiseless markers, as a function of pose, of a robot with this face's joints.

    Parameters
    ----------
    rest_mm : Array
        (47, 3) mm, markers of a closed mouth.
    servos : MouthServos
        Servos of the face.

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
    """Return the joints whose motion is guessed.

    These are joints of which neither the name nor `positive` of the YAML says what they move. None
    in the family OWN, whose joints have fixed names.
    """
    if (family or family_of(servos)) is RobotFamily.OWN:
        return ()
    pulls = pulls_of(servos.names, servos.positive)
    return [n for n, pull in zip(servos.names, pulls, strict=True) if pull.is_guess]


def _check_joints(servos: MouthServos) -> None:
    if not servos.joints:
        raise CalibrationError(
            "the face has no servo of `part: mouth`, so there is nothing to calibrate"
        )
