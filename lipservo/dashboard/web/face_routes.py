"""The API's commands and answers about the face itself."""

import asyncio
from typing import Any

from fastapi import APIRouter
from lipservo_client.face_answers import FaceError

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.servo_remedies import is_stopped, told_servos
from lipservo.dashboard.told_calibration import told_calibration
from lipservo.dashboard.web.api_models import (
    AffectBody,
    JogBody,
    LookBody,
    SayBody,
    ServoBody,
    StartBody,
    StopBody,
)
from lipservo.dashboard.web.stop_route import stop_face

Told = dict[str, Any]
_COUNTS = (
    "n_late", "n_stale", "n_unplugged", "n_rejected_targets", "range_hits_total",
    "rate_hits_total", "rejected_total", "prevented_total", "n_lost_sound_blocks",
    "n_playout_underruns",
)  # fmt: skip


def face_routes(link: FaceLink) -> APIRouter:
    """Status, commands, servos, faults, calibration."""
    routes = APIRouter(prefix="/api")

    @routes.get("/status")
    async def status() -> Told:
        """The face's `Status` (docs/architecture.md), and how sure that is.

        face_answers: false: what follows is what it said last, `age_s` ago.
        """
        return {**(link.status or {}), **link.certainty()}

    @routes.post("/stop")
    async def stop(body: StopBody | None = None) -> Told:
        """Stop the face. On this computer it needs no token. A daemon then waits for a start."""
        # Answered by `StopRoute`, which is around all of this, and described here.
        return await stop_face(link, body or StopBody())

    @routes.post("/start")
    async def start(body: StartBody | None = None) -> Told:
        """Drive a stopped face again, through the ordinary checks. It moves."""
        return dict(await link.start((body or StartBody()).wait_s))

    @routes.post("/say")
    async def say(body: SayBody) -> Told:
        """Say a text. Answered when it is to be said, not once it was."""
        return dict(await link.say(body.text))

    @routes.post("/interrupt")
    async def interrupt() -> Told:
        """Silence now: what the face says or plays is dropped."""
        await link.interrupt()
        return {"silent": True}

    @routes.post("/look-at")
    async def look_at(body: LookBody) -> Told:
        """Look somewhere, or nowhere in particular."""
        return dict(await link.look_at(body.yaw_deg, body.pitch_deg))

    @routes.post("/affect")
    async def affect(body: AffectBody) -> Told:
        """Set a mood, which fades."""
        return dict(await link.affect(body.valence, body.arousal, body.tau_s))

    @routes.get("/servos")
    async def servos() -> Told:
        """How each servo is, what ails it in plain words, and what to do."""
        # Of a face that is stopped no servo side runs, and its status says all that is known.
        knows = not link.servos_gone or is_stopped(link.status)
        told = told_servos(link.status, is_fresh=link.answers and knows)
        return {"servos": told, **link.certainty()}

    @routes.post("/servos/{name}")
    async def servo(name: str, body: ServoBody) -> Told:
        """Torque of one servo off or on, or restart it."""
        _check_known(link, name)
        return dict(await link.servo(name, body.action))

    @routes.post("/jog")
    async def jog(body: JogBody) -> Told:
        """Move single servos by hand, within their limits; ends 3 s after the last request."""
        if body.action != "move":
            return dict(await (link.jog_arm() if body.action == "arm" else link.jog_end()))
        if body.servo is None or body.deg is None:
            raise FaceError("refused", "move needs servo and deg")
        _check_known(link, body.servo)
        return dict(await link.jog(body.servo, body.deg))

    @routes.get("/faults")
    async def faults() -> Told:
        """What is wrong: troubles, fallbacks, what is gone, and counts since the start."""
        status = link.status or {}
        names = ("state", "stopped", "plugged", "fallback_level", "output_lost")
        return {
            **{name: status.get(name) for name in names},
            "troubles": list(status.get("troubles") or ()),
            "fallback_reasons": list(status.get("fallback_reasons") or ()),
            "counts": {name: status.get(name) for name in _COUNTS},
            **link.certainty(),
        }

    @routes.get("/calibration")
    async def calibration() -> Told:
        """What the face's calibration file says: coverage and error of each joint, trims."""
        return await asyncio.to_thread(told_calibration, (link.status or {}).get("config"))

    @routes.get("/health")
    async def health() -> Told:
        """For whoever watches over the dashboard: it serves; and whether its face is there."""
        return {"serves": True, **link.certainty()}

    return routes


def _check_known(link: FaceLink, name: str) -> None:
    """Raises FaceError for a servo that a face which is known does not have."""
    known = list((link.status or {}).get("servos") or link.layout.servos)
    if known and name not in known:
        raise FaceError("not_found", f"no servo of that name; there are: {', '.join(known)}")
