"""Where a face keeps what outlives it: health logs, and a person's stop.

In the state folder of the user or of the service.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path

#: What the shipped unit gives the service (`StateDirectory=lipservo`); readable for all.
SERVICE_STATE = Path("/var/lib/lipservo")


def log_folder(face: str, port: str, environment: Mapping[str, str]) -> Path | None:
    """Where the readings of a face at this port go; None: there is no such place.

    A pseudo-terminal leads to simulated servos: these have a folder of their own, or a rehearsal
    would spoil the figures of the real ones.
    """
    state = _own_state(environment)
    return None if state is None else state / "health" / _name_at(face, port)


def stop_record_path(face: str, port: str, environment: Mapping[str, str]) -> Path | None:
    """The file that keeps a person's stop of a face at this port; None: there is no such place."""
    state = _own_state(environment)
    return None if state is None else state / "stops" / f"{_name_at(face, port)}.json"


def _name_at(face: str, port: str) -> str:
    simulated = os.path.realpath(port).startswith("/dev/pts/")
    return folder_name(face) + ("-simulated" if simulated else "")


def folder_name(face: str) -> str:
    """A face's name as a folder: its words in small letters, with dashes between, 60 at most."""
    return re.sub(r"\W+", "-", face.lower())[:60].strip("-") or "face"


def logged_faces(environment: Mapping[str, str]) -> dict[str, list[Path]]:
    """The folders of every face with a log, the user's own and the service's."""
    own = _own_state(environment)
    places = [own] if environment.get("LIPSERVO_STATE") else [own, SERVICE_STATE]
    found: dict[str, list[Path]] = {}
    for place in [each for each in places if each is not None]:
        try:
            folders = sorted(each for each in (place / "health").iterdir() if each.is_dir())
        except OSError:
            continue
        for folder in folders:
            found.setdefault(folder.name, []).append(folder)
    return found


def places_searched(environment: Mapping[str, str]) -> str:
    """For the line that says that nothing was found."""
    own = _own_state(environment)
    if environment.get("LIPSERVO_STATE"):
        return f"{own}/health"
    places = [own, SERVICE_STATE]
    return " and ".join(f"{each}/health" for each in places if each is not None)


def _own_state(environment: Mapping[str, str]) -> Path | None:
    """$LIPSERVO_STATE, $XDG_STATE_HOME/lipservo or ~/.local/state/lipservo.

    https://specifications.freedesktop.org/basedir-spec/latest/ : a relative path is ignored.
    """
    asked = environment.get("LIPSERVO_STATE")
    if asked:
        return Path(asked)
    state = environment.get("XDG_STATE_HOME", "")
    if os.path.isabs(state):
        return Path(state) / "lipservo"
    home = environment.get("HOME", "")
    return Path(home) / ".local/state/lipservo" if os.path.isabs(home) else None
