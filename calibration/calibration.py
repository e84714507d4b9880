"""The map from one face model's motion to one robot's servo angles, and its coupling rules."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from calibration.closure import Closure, pairs
from calibration.grade import Closing, Grade, HoldOutErrors, LearntLips, VisemeReach
from lipsync.arrays import Array
from lipsync.errors import UserError

_SAME_DEG = 1e-9


@dataclass(frozen=True, slots=True)
class CouplingRule:
    """A limit on a weighted sum of joint angles: sum_s weights_s x angle_s <= at_most_deg.

    It keeps lips from running into each other, for instance. weights: (n_servos,), 0 for a joint
    that the rule ignores; at_most_deg >= 0, so that neutral never breaks the rule.
    """

    weights: Array
    at_most_deg: float


def keep_rules(rules: Sequence[CouplingRule], positions_deg: Array) -> Array:
    """Return joint angles scaled towards neutral until no rule is broken.

    The joints with a weight in a broken rule are multiplied by one factor below 1, which keeps them
    within limits that include 0. Where that breaks another rule, all joints are scaled by one
    factor.

    Parameters
    ----------
    rules : Sequence[CouplingRule]
        Coupling rules of the face.
    positions_deg : Array
        (n_servos,) degrees, within the limits.

    Returns
    -------
    Array
        (n_servos,) degrees.
    """
    for rule in rules:
        sum_deg = float(rule.weights @ positions_deg)
        if sum_deg > rule.at_most_deg + _SAME_DEG:
            factor = rule.at_most_deg / sum_deg
            positions_deg = np.where(rule.weights != 0.0, factor * positions_deg, positions_deg)
    for rule in rules:
        sum_deg = float(rule.weights @ positions_deg)
        if sum_deg > rule.at_most_deg + _SAME_DEG:
            positions_deg = positions_deg * (rule.at_most_deg / sum_deg)
    return positions_deg


if TYPE_CHECKING:
    from lipsync.face.model import FaceModel

_REMEDY = "run `lipservo calibrate fit --config FACE -o FILE`, or `measure` on its servos"
_OTHER_MODEL = (
    "give the model it was made for with --model (without --model it is the shipped one), or run "
    "`lipservo calibrate fit --config FACE --model MODEL -o FILE` for this one"
)
#: Models keep their rest in float32, about 1e-6 of a coefficient; any other rest is another mouth.
_REST_TOLERANCE = 1e-4


class CalibrationError(UserError):
    """An error: a calibration cannot be made or used; the message has place, cause and remedy."""


@dataclass(frozen=True, slots=True)
class Following:
    """How each servo's angle follows its goal angle; all arrays are (n_servos,).

    lag_s: delay behind the goal at the frequencies of speech; backlash_deg: whole width of the
    backlash; bandwidth_hz: at -3 dB. Speed and bandwidth are inf where not known.
    """

    lag_s: Array
    backlash_deg: Array
    top_speed_deg_s: Array
    bandwidth_hz: Array


@dataclass(frozen=True, slots=True)
class Touch:
    """A pose, (n_servos,) degrees, in which lips just meet, and the most mA for a servo then."""

    positions_deg: Array
    current_cap_ma: float


@dataclass(frozen=True, slots=True)
class ServoMemory:
    """Registers of a servo at the time of its calibration, in the registers' own units (pulses).

    A change of any of them moves a joint angle, or changes whether the angle can be reached.
    """

    homing_offset: int
    drive_mode: int
    min_position_limit: int
    max_position_limit: int


@dataclass(frozen=True, slots=True)
class Origin:
    """How, when and from which servos a calibration was made.

    method: `simulated face`, `measured` or `guided`, for instance; date: ISO 8601; servo_models,
    servo_memories: one per servo, or empty where no servo was read. not_measured: what the tracker
    cannot measure, such as `protrusion` for one camera.
    """

    method: str
    date: str = ""
    poses: int = 0
    servo_models: tuple[str, ...] = ()
    servo_memories: tuple[ServoMemory, ...] = ()
    not_measured: str = ""


@dataclass(frozen=True, slots=True)
class Calibration:
    """A map from face coefficients to servo angles: quadratic and limited.

    angles = rest_deg + weights @ x + quadratic_weights @ (x_i x_j), x = coefficients - rest, kept
    in x_range.

    weights: (n_servos, n_components), degrees; quadratic_weights: (n_servos, n_pairs), pairs i <= j
    row by row, or no columns for a linear map; rest: (n_components,); rest_deg: (n_servos,), the
    angles at rest; x_range: (2, n_components), least and most x of the fitted frames; min_deg,
    max_deg: (n_servos,), the face's limits at the time of the fit. trim: degrees (n_servos,) to add
    while a viseme class is spoken, by the first phoneme of the class. hand_poses: angles
    (n_servos,) that a person set by hand, by name. rules: from the face's YAML, never from the
    calibration file; every pose keeps them. grade: None where nothing was measured after the fit.
    learnt_lips: None where no lips were captured; closure: None where it is not known how this
    robot's lips close; closing: None without clear evidence of whether the lips meet.
    """

    servo_names: tuple[str, ...]
    weights: Array
    quadratic_weights: Array
    rest: Array
    rest_deg: Array
    x_range: Array
    min_deg: Array
    max_deg: Array
    errors: HoldOutErrors
    model_checksum: str
    face_checksum: str
    origin: Origin = Origin("simulated face")
    following: Following | None = None
    touch: Touch | None = None
    coverage: Mapping[str, VisemeReach] = field(default_factory=dict)
    trim: Mapping[str, Array] = field(default_factory=dict)
    hand_poses: Mapping[str, Array] = field(default_factory=dict)
    rules: tuple[CouplingRule, ...] = ()
    grade: Grade | None = None
    learnt_lips: LearntLips | None = None
    closure: Closure | None = None
    closing: Closing | None = None

    def positions_deg(self, coefficients: Array) -> Array:
        """Return the servos' joint angles for one face, within the limits and coupling rules.

        Parameters
        ----------
        coefficients : Array
            (n_components,) coefficients of the face, in mm.

        Returns
        -------
        Array
            (n_servos,) degrees, in the order of `servo_names`.
        """
        return np.asarray(self.poses_deg(coefficients[None])[0])

    def poses_deg(self, faces: Array) -> Array:
        """Return the joint angles for several faces, within the limits and coupling rules.

        Parameters
        ----------
        faces : Array
            (k, n_components) coefficients, in mm.

        Returns
        -------
        Array
            (k, n_servos) degrees, in the order of `servo_names`.
        """
        # Change from the rest, kept within the range of the frames that the map was fitted to.
        x = np.minimum(np.maximum(faces - self.rest, self.x_range[0]), self.x_range[1])
        free_deg = self.rest_deg + x @ self.weights.T
        if self.quadratic_weights.shape[1]:
            first, second = pairs(x.shape[1])
            free_deg = free_deg + (x[:, first] * x[:, second]) @ self.quadratic_weights.T
        limited_deg: Array = np.minimum(np.maximum(free_deg, self.min_deg), self.max_deg)
        if self.closure is not None:
            limited_deg = self.closure.corrected_deg(x, limited_deg, self.min_deg, self.max_deg)
        if not self.rules:
            return limited_deg
        return np.array([keep_rules(self.rules, pose_deg) for pose_deg in limited_deg])


def linear_calibration_parts(n_servos: int, n_components: int) -> tuple[Array, Array, Array]:
    """Return quadratic_weights, rest_deg and x_range of a linear map that is 0 degrees at rest.

    Parameters
    ----------
    n_servos,n_components : int
        Number of servos, and of coefficients of a face.

    Returns
    -------
    tuple[Array, Array, Array]
        No quadratic terms (n_servos, 0), zeros (n_servos,) and -inf, inf (2, n_components).
    """
    bound = np.full(n_components, np.inf)
    return np.zeros((n_servos, 0)), np.zeros(n_servos), np.array([-bound, bound])


def check_calibration(
    calibration: Calibration, model: "FaceModel", servo_names: Sequence[str], face_checksum: str
) -> None:
    """Raise CalibrationError unless `calibration` was made for this speaker's model and this face.

    Compared are the servo names, the model's checksum and rest, and face_checksum, that of the
    face's YAML file; the message contains the remedy. servo_names: the servos that move the mouth;
    those of a neck or an eye have no calibration.
    """
    for name in servo_names:
        if name not in calibration.servo_names:
            raise CalibrationError(f"servo {name!r} has no calibration; {_REMEDY}")
    for name in calibration.servo_names:
        if name not in servo_names:
            raise CalibrationError(f"calibrated servo {name!r} is not in this face; {_REMEDY}")
    if calibration.model_checksum != model.checksum:
        raise CalibrationError(
            f"this calibration was made for model {calibration.model_checksum}, this is model "
            f"{model.checksum}; {_OTHER_MODEL}"
        )
    if not np.allclose(calibration.rest, model.rest, rtol=0.0, atol=_REST_TOLERANCE):
        raise CalibrationError(f"calibration was made for another closed mouth; {_OTHER_MODEL}")
    if calibration.face_checksum != face_checksum or calibration.servo_names != tuple(servo_names):
        raise CalibrationError(
            f"this calibration was made for face {calibration.face_checksum}, this is face "
            f"{face_checksum}: its servos or limits have changed since; {_REMEDY}"
        )


def check_servo_models(calibration: Calibration, servo_models: Sequence[str]) -> None:
    """Raise CalibrationError if a servo is of another model than when it was calibrated.

    servo_models: models of the calibrated servos, in their order. A calibration that names no servo
    models passes.
    """
    models_before = calibration.origin.servo_models or tuple(servo_models)
    unnamed = "servo without a model"
    changes = [
        f"servo {name!r} was calibrated as a {was or unnamed} and is a {now or unnamed} "
        "in this face"
        for name, was, now in zip(calibration.servo_names, models_before, servo_models, strict=True)
        if was != now
    ]
    if changes:
        raise CalibrationError(f"{'; '.join(changes)}; {_REMEDY}")


def check_servo_memories(calibration: Calibration, memories: Sequence[ServoMemory | None]) -> None:
    """Raise CalibrationError, naming servo and register, if a memory has changed since calibration.

    memories: of the calibrated servos, in their order; a servo that did not answer is None and is
    skipped; empty: these servos store nothing. A calibration made without servos passes.
    """
    memories_before = calibration.origin.servo_memories
    if not memories_before or not memories:
        return
    changes = []
    for name, was, now in zip(calibration.servo_names, memories_before, memories, strict=True):
        if was is None or now is None:
            continue
        for field_ in fields(ServoMemory):
            value_before, value_now = getattr(was, field_.name), getattr(now, field_.name)
            if value_before != value_now:
                changes.append(
                    f"servo {name!r} has {field_.name.replace('_', ' ')} {value_now} and was "
                    f"calibrated with {value_before}"
                )
    if changes:
        raise CalibrationError(
            f"{'; '.join(changes)}; run `lipservo setup-servos`, or calibrate anew"
        )
