"""Every scene on every bus, and what came of all statements in it."""

import subprocess
from itertools import product

from lipservo_lab.bench.statements.claims import Judge, Tally
from lipservo_lab.bench.statements.heard_face import HeardFace, heard_face
from lipservo_lab.bench.statements.rules import RULES
from lipservo_lab.bench.statements.scenes import CRITICAL, SCENES
from lipservo_lab.bench.stops.faces_on_buses import BUSES


def scenes() -> list[tuple[str, str]]:
    """Return all pairs (bus, scene)."""
    return [(bus, scene) for scene, bus in product(SCENES, BUSES)]


def play_scene(bus: str, scene: str) -> tuple[Tally, list[str]]:
    """Play one scene on one kind of bus; return the tally of its statements, and errors.

    An error is a line, where the scene broke off. Takes some forty seconds, and longer on a busy
    computer.
    """
    errors = []
    with heard_face(bus, critical=scene in CRITICAL) as face:
        try:
            SCENES[scene](face, bus)
        except (OSError, RuntimeError, subprocess.SubprocessError) as error:
            errors.append(f"{bus}/{scene}: {type(error).__name__}: {error}")
        face.close()
        return judge_of(face).judge(list(face.statements), f"{bus}/{scene}"), errors


def judge_of(face: HeardFace) -> Judge:
    """Return the judge of a face's statements by the log of its servos."""
    settings = face.robot.settings
    return Judge(RULES, face.robot.device, settings.joints(), settings.name)
