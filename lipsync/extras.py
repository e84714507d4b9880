"""Libraries that only some commands need: which extra brings each, and one line where it is absent.

pyproject.toml lists the same; tests/project/test_dependencies.py compares.
"""

from importlib.util import find_spec

from lipsync.errors import UserError

#: Library, as it is imported, and the extra that brings it.
EXTRA_OF = {
    "gruut": "align",
    "pocketsphinx": "align",
    "torch": "train",
    "trimesh": "scans",
    "ezc3d": "mocap",
    "ai_edge_litert": "video",
    "av": "video",
    "cv2": "dots",
    "mediapipe": "video",
    "matplotlib": "plots",
    "rustypot": "bench",
    "espeakng_loader": "say",
    "dtaidistance": "offline",
    "joblib": "offline",
    "distributed": "cluster",
    "pipecat": "pipecat",
    "fastapi": "dashboard",
    "nicegui": "dashboard",
    "prometheus_client": "dashboard",
    "ruamel": "dashboard",
    "starlette": "dashboard",
    "uvicorn": "dashboard",
}


class MissingExtraError(UserError):
    """A library is not installed that this command needs; one line that names its extra."""


def check_extra(library: str, purpose: str) -> None:
    """Raises MissingExtraError unless `library` is installed, one of `EXTRA_OF`.

    purpose: what needs it, in words. Loads nothing, so that it can be asked before the work.
    """
    if find_spec(library) is None:
        raise MissingExtraError(
            f"{purpose} needs {library}, which is not installed: "
            f"`pip install 'lipservo[{EXTRA_OF[library]}]'`"
        )
