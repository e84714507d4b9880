"""Libraries that only some commands need: which extra brings each, and one line where it is absent.

The pyproject.toml of the program, of lab/ and of client/ list the same;
tests/project/test_dependencies.py compares.
"""

from importlib.util import find_spec

from lipsync.errors import UserError

#: Library, as it is imported, and the extra that brings it: of lipservo, or of the one named.
EXTRA_OF = {
    "gruut": "lipservo[align]",
    "pocketsphinx": "lipservo[align]",
    "torch": "lipservo-lab[train]",
    "trimesh": "lipservo-lab[scans]",
    "ezc3d": "lipservo[mocap]",
    "ai_edge_litert": "lipservo[video]",
    "av": "lipservo[video]",
    "cv2": "lipservo[dots]",
    "mediapipe": "lipservo[video]",
    "matplotlib": "lipservo[plots]",
    "rustypot": "lipservo-lab[bench]",
    "espeakng_loader": "lipservo[say]",
    "dtaidistance": "lipservo[offline]",
    "joblib": "lipservo-lab[offline]",
    "distributed": "lipservo-lab[cluster]",
    "pipecat": "lipservo-client[pipecat]",
    "fastapi": "lipservo[dashboard]",
    "nicegui": "lipservo[dashboard]",
    "prometheus_client": "lipservo[dashboard]",
    "ruamel": "lipservo[dashboard]",
    "starlette": "lipservo[dashboard]",
    "uvicorn": "lipservo[dashboard]",
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
            f"`pip install '{EXTRA_OF[library]}'`"
        )
