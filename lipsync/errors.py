"""Errors that the user can correct, among them a library of an extra that is not installed.

The pyproject.toml of the program, of lab/ and of client/ list the extras too;
tests/project/test_dependencies.py compares them.
"""

import reprlib
from importlib.util import find_spec
from pathlib import Path

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 60
_SHORT.maxlevel = 2
_SHORT.maxdict = _SHORT.maxlist = _SHORT.maxtuple = 3


class UserError(ValueError):
    """Error for a user's mistake: the text says in one line what, where, and what to do.

    The command line prints it without a traceback; every other exception is a fault of the program.
    """


def shown(value: object) -> str:
    """Return a value from a user's file as text for an error message, shortened if it is long."""
    return _SHORT.repr(value)


#: Library, as it is imported, and the extra that brings it: of lipservo, or of the one named.
EXTRA_OF = {
    "gruut": "lipservo[align]",
    "gruut_lang_en": "lipservo[align]",
    "pocketsphinx": "lipservo[align]",
    "torch": "lipservo-lab[train]",
    "trimesh": "lipservo-lab[scans]",
    "ezc3d": "lipservo[mocap]",
    "ai_edge_litert": "lipservo[video]",
    "PIL": "lipservo[film]",
    "av": "lipservo[film]",
    "cv2": "lipservo[dots]",
    "scipy": "lipservo[fit]",
    "sklearn": "lipservo[fit]",
    "threadpoolctl": "lipservo[fit]",
    "mediapipe": "lipservo[video]",
    "matplotlib": "lipservo[plots]",
    "rustypot": "lipservo-lab[bench]",
    "statsmodels": "lipservo-lab[study]",
    "espeakng_loader": "lipservo[say]",
    "piper": "lipservo[piper]",
    "dtaidistance": "lipservo[offline]",
    "smbus2": "lipservo[pca9685]",
    "gpiod": "lipservo[pca9685]",
    "joblib": "lipservo-lab[offline]",
    "distributed": "lipservo-lab[cluster]",
    "livekit": "lipservo-client[livekit]",
    "loguru": "lipservo-client[pipecat]",
    "pipecat": "lipservo-client[pipecat]",
    "wyoming": "lipservo-client[wyoming]",
    "fastapi": "lipservo[dashboard]",
    "nicegui": "lipservo[dashboard]",
    "prometheus_client": "lipservo[dashboard]",
    "starlette": "lipservo[dashboard]",
    "uvicorn": "lipservo[dashboard]",
}


class MissingExtraError(UserError):
    """Error for a library, needed by a command, that is not installed; one line names its extra."""


def check_inputs(*paths: Path | None) -> None:
    """Raise UserError for a file that cannot be read; None and folders are accepted."""
    for path in paths:
        if path is None or path.is_dir():
            continue
        try:
            path.open("rb").close()
        except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
            reason = getattr(error, "strerror", None) or error
            raise UserError(f"{path}: cannot be read: {reason}") from error


def check_extra(library: str, purpose: str) -> None:
    """Raise MissingExtraError unless `library`, a key of `EXTRA_OF`, is installed.

    purpose: what needs the library, in words. Nothing is imported, so that a command can check it
    before its work begins.
    """
    if find_spec(library) is None:
        raise MissingExtraError(
            f"{purpose} needs {library}, which is not installed: "
            f"`pip install '{EXTRA_OF[library]}'`"
        )
