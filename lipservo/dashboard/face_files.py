"""The files of a running face: settings written into its YAML, and values of its calibration.

The YAML is written whole or not at all, and its comments stay. Functions raise FaceError, one
line, with the code refused, not_saved or not_available.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from lipservo_client.protocol import FaceError

from lipservo.runtime.speech.expression import ExpressionRequests
from lipservo.settings import found_limits
from lipservo.settings.edited_yaml import EditedYaml, Place, edited, read_face_text
from lipservo.settings.found_limits import PulseLimit
from lipservo.settings.settings import parse_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.errors import UserError
from lipsync.face.model import load_face
from lipsync.output_file import write_whole

if TYPE_CHECKING:
    from calibration.calibration import Calibration


def own_yaml(config: str | None) -> Path:
    """Return the YAML path of a user's own face. Raises FaceError for a shipped face, or None."""
    if config is None:
        raise FaceError("refused", "this face has not told where its YAML is; try again")
    try:
        return found_limits.own_yaml(config)
    except UserError as error:
        raise FaceError("refused", str(error)) from error


def set_pulse_limit(
    config: str | None, servo: str, limit: PulseLimit, pulse_us: float
) -> dict[str, Any]:
    """Write one pulse limit (us) of a hobby servo into the face's YAML.

    Returns the servo's name, all its limits, and a note on when they count. Raises FaceError.
    """
    path = own_yaml(config)
    with face_errors():
        edit = found_limits.with_pulse_limit(path, servo, limit, pulse_us)
        edit.write()
        if limit == "neutral" and edit.text != edit.before:
            found_limits.forget_poses(path)
        new_servo = parse_face(edit.text, path.name).servos[servo]
    degrees = {"min_deg": new_servo.min_deg, "max_deg": new_servo.max_deg}
    assert new_servo.pulse is not None  # checked by `with_pulse_limit`
    pulse = asdict(new_servo.pulse)
    return {"servo": servo, "set": {**pulse, **degrees}, "note": found_limits.what_next(edit)}


def saved_settings(config: str | None) -> dict[str, Any]:
    """Return the motion settings in the face's YAML, and `expression`, the amount of expression.

    config: the face's name or YAML path; None: not known. Motion settings that the YAML leaves out
    are missing; `expression` is always present.
    """
    path = own_yaml(config)
    with face_errors():
        face = parse_face(_read_text(path), path.name)
    return {**face.motion.model_dump(exclude_none=True), "expression": face.expression.amount}


def with_settings(path: Path, values: Mapping[str, float]) -> EditedYaml:
    """Return an unwritten edit of the YAML at `path` with settings `values`. Raises FaceError.

    `refused`: a setting that is never saved, or a value out of range; `not_saved`: a file that
    cannot be read.
    """
    places = {_yaml_place(name): value for name, value in values.items()}
    _read_text(path)  # raises not_saved where the YAML cannot be read
    with face_errors():
        return edited(path, places)


def sound_choices(config: str | None) -> dict[str, Any]:
    """Return the devices, synthesisers, languages and voices to choose from, and those chosen.

    inputs, outputs: names of devices, none without a sound system. languages, voices: of the chosen
    synthesiser. Raises FaceError if `config` is None.
    """
    from lipservo.runtime.servos.assembly import load_settings
    from lipsync.audio.devices import sound_devices
    from lipsync.audio.source import SoundError
    from lipsync.plugins import SYNTHESIZERS, PluginError
    from lipsync.text_to_speech.synthesis import SynthesisError
    from lipsync.text_to_speech.synthesizers import synthesizer_for

    if config is None:
        raise FaceError("not_available", "this face has not told where its YAML is; try again")
    chosen = load_settings(config)[0].sound
    found: dict[str, Any] = {"inputs": [], "outputs": [], "languages": [], "voices": []}
    with suppress(SoundError):
        found["inputs"] = [each.lasting_name for each in sound_devices("input")]
        found["outputs"] = [each.lasting_name for each in sound_devices("output")]
    with suppress(PluginError, SynthesisError, UserError):
        engine = synthesizer_for(chosen.synthesizer)
        found["languages"], found["voices"] = list(engine.languages()), list(engine.voices())
    found["synthesizers"] = SYNTHESIZERS.names()
    chosen_now = chosen.model_dump(exclude={"output_offset_ms"})
    return {**found, "chosen": chosen_now, "is_shipped": not config.endswith((".yaml", ".yml"))}


def choose_sound(config: str | None, values: Mapping[str, str | float]) -> dict[str, Any]:
    """Write choices into `sound:` of the face's own YAML, for its next start.

    values: by key of that section. Returns the values and the file's name. Raises FaceError for a
    shipped face.
    """
    path = own_yaml(config)
    with face_errors():
        edited(path, {("sound", name): value for name, value in values.items()}).write()
    return {"saved": dict(values), "in": path.name}


def copy_shipped(config: str | None) -> dict[str, Any]:
    """Copy a shipped face's YAML into the working folder; return the file and a command to run it.

    Raises FaceError for a user's own face, and if the file already exists.
    """
    if config is None or config.endswith((".yaml", ".yml")):
        raise FaceError("refused", "this face's YAML is already your own file; edit it directly")
    path = Path.cwd() / f"my_{config}.yaml"
    if path.exists():
        raise FaceError("refused", f"{path} already exists; start that face, or move the file away")
    with face_errors():
        write_whole(path, (resources.files("lipservo.config") / f"{config}.yaml").read_bytes())
    return {"file": str(path), "command": f"lipservo run --config {path.name} --dashboard"}


@contextmanager
def face_errors() -> Iterator[None]:
    """Convert SettingsError into FaceError `refused`, other UserErrors into `not_saved`."""
    try:
        yield
    except SettingsError as error:
        raise FaceError("refused", "; ".join(str(error).splitlines())) from error
    except UserError as error:
        raise FaceError("not_saved", str(error)) from error


def _yaml_place(name: str) -> Place:
    """Return the YAML section and key of setting `name`. Raises FaceError if it is never saved."""
    if name in ExpressionRequests.PASSING:
        raise FaceError("refused", f"{name} lasts only while the face runs and is never saved")
    return ("expression", "amount") if name == "expression" else ("motion", name)


def _read_text(path: Path) -> str:
    try:
        return read_face_text(path)
    except SettingsError as error:
        raise FaceError("not_saved", str(error)) from error


def calibration_values(config: str | None) -> dict[str, Any]:
    """Return the calibration as `lipservo calibrate show --json` does, its file's name, `lip_gap`.

    lip_gap: poses of likely faces and these faces' lip gaps, from which a page estimates the gap
    that encoders show; None for a model that does not ship.
    Raises FaceError where there is none, or it cannot be read.
    """
    from calibration.files.calibration_file import parse_calibration
    from lipservo.calibrating.shown_calibration import shown_values
    from lipservo.runtime.servos.assembly import load_settings
    from lipservo.settings.settings import calibration_file

    if config is None:
        raise FaceError("not_available", "this face has not told where its YAML is; try again")
    try:
        settings, folder = load_settings(config)
        file = calibration_file(settings, folder)
        calibration = parse_calibration(file.read_text(encoding="utf-8"), file.name)
    except (UserError, OSError, UnicodeDecodeError) as error:
        raise FaceError("not_available", " ".join(str(error).split())) from error
    values = shown_values(calibration, settings.prevent)
    is_current = calibration.face_checksum == settings.checksum
    return {
        "file": file.name,
        "fits_the_face": is_current,
        "lip_gap": _lip_gaps(calibration),
        **values,
    }


def _lip_gaps(calibration: "Calibration") -> dict[str, Any] | None:
    """Return joint angles (300, n_servos) and lip gaps (300,) of faces as likely as in speech."""
    model = load_face()
    if model.checksum != calibration.model_checksum:
        return None
    likely = np.random.default_rng(0).multivariate_normal
    faces = likely(np.zeros(model.n_components), model.covariance, 300)
    gaps_mm = model.lip_gaps_mm(model.markers_mm(faces))
    poses_deg = calibration.poses_deg(faces).round(2).tolist()
    return {"servos": calibration.servo_names, "poses_deg": poses_deg, "gaps_mm": gaps_mm.tolist()}
