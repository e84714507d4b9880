"""What the calibration of a running face says, read from its file."""

from typing import Any

from lipservo_client.face_answers import FaceError

from lipsync.errors import UserError


def told_calibration(config: str | None) -> dict[str, Any]:
    """The same as `lipservo calibrate show --json`, with the file's name. Raises FaceError."""
    from calibration.files.calibration_file import parse_calibration
    from lipservo.calibrating.shown_calibration import shown_values
    from lipservo.face.assembly import load_settings
    from lipservo.settings.settings import calibration_file

    if config is None:
        raise FaceError("not_available", "the face does not say where its YAML is")
    try:
        settings, folder = load_settings(config)
        file = calibration_file(settings, folder)
        found = parse_calibration(file.read_text(encoding="utf-8"), file.name)
    except (UserError, OSError, UnicodeDecodeError) as error:
        raise FaceError("not_available", " ".join(str(error).split())) from error
    told = shown_values(found, settings.prevent)
    is_current = found.face_checksum == settings.checksum
    return {"file": file.name, "fits_the_face": is_current, **told}
