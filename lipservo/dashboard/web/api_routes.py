"""Routes of the API for commands to the face, its status, its settings and its sound files."""

import asyncio
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fastapi import APIRouter, HTTPException, Request
from fastapi.responses import JSONResponse
from lipservo_client.protocol import FaceError
from starlette.requests import ClientDisconnect

from lipservo.dashboard.face_files import (
    calibration_values,
    choose_sound,
    copy_shipped,
    face_errors,
    own_yaml,
    saved_settings,
    set_pulse_limit,
    sound_choices,
    with_settings,
)
from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.servo_remedies import is_stopped, listed_servos
from lipservo.dashboard.sound_lines import MOST_BYTES, SoundLines, Uploads, checked_name
from lipservo.dashboard.web.api_models import (
    AffectBody,
    JogBody,
    LookBody,
    PlayBody,
    PulseLimitBody,
    SayBody,
    ServoBody,
    SettingsBody,
    SoundBody,
    StartBody,
    StopBody,
)
from lipservo.dashboard.web.stop_route import stop_face

JsonObject = dict[str, Any]
VERSION = version("lipservo")
_COUNTS = (
    "n_late", "n_stale", "n_unplugged", "n_rejected_targets", "range_hits_total",
    "rate_hits_total", "rejected_total", "prevented_total", "n_lost_sound_blocks",
    "n_playout_underruns",
)  # fmt: skip


def face_routes(link: FaceLink) -> APIRouter:
    """Return the routes for status, commands, servos, faults, calibration and health."""
    routes = APIRouter(prefix="/api")
    one_at_a_time = asyncio.Lock()

    @routes.get("/status")
    async def status() -> JsonObject:
        """The face's `Status` (docs/architecture.md), and how sure that is.

        face_answers: false: the rest is its last status, `age_s` ago. version: of lipservo.
        """
        return {**(link.status or {}), **link.certainty(), "version": VERSION}

    @routes.post("/stop")
    async def stop(body: StopBody | None = None) -> JsonObject:
        """Stop the face. On this computer it needs no token. A daemon then waits for a start."""
        # Answered by `StopRoute`, which is around all of this, and described here.
        return await stop_face(link, body or StopBody())

    @routes.post("/start")
    async def start(body: StartBody | None = None) -> JsonObject:
        """Drive a stopped face again, through the ordinary checks. It moves."""
        return dict(await link.start((body or StartBody()).wait_s))

    @routes.post("/say")
    async def say(body: SayBody) -> JsonObject:
        """Say a text. Answered when it is queued, not once it was spoken."""
        return dict(await link.say(**body.model_dump(exclude_none=True)))

    @routes.post("/interrupt")
    async def interrupt() -> JsonObject:
        """Drop what the face says or plays by itself; an agent that speaks goes on."""
        await link.interrupt()
        return {"accepted": "interrupt"}

    @routes.post("/look-at")
    async def look_at(body: LookBody) -> JsonObject:
        """Aim the gaze at angles, or at no target."""
        return dict(await link.look_at(body.yaw_deg, body.pitch_deg))

    @routes.post("/affect")
    async def affect(body: AffectBody) -> JsonObject:
        """Set a mood, which fades."""
        return dict(await link.affect(body.valence, body.arousal, body.tau_s))

    @routes.get("/servos")
    async def servos() -> JsonObject:
        """How each servo is, what ails it in plain words, and what to do."""
        # No servo side runs while the face is stopped: its status is all that is known then.
        is_current = not link.snapshot.servos_gone or is_stopped(link.status)
        listed = listed_servos(link.status, is_fresh=link.answers and is_current)
        return {"servos": listed, **link.certainty()}

    @routes.post("/servos/{name}")
    async def servo(name: str, body: ServoBody) -> JsonObject:
        """Torque of one servo off or on, or restart it."""
        _check_servo_exists(link, name)
        return dict(await link.servo(name, body.action))

    @routes.post("/jog")
    async def jog(body: JogBody) -> JsonObject:
        """Move single servos by hand, within their limits; ends 3 s after the last request.

        By its pulse a hobby servo goes beyond them, at most 10 us at a time: docs/hardware.md.
        """
        if body.action != "move":
            return dict(await (link.jog_arm() if body.action == "arm" else link.jog_end()))
        if body.servo is None or (body.deg is None) == (body.pulse_us is None):
            raise FaceError("refused", "move needs servo, and either deg or pulse_us, not both")
        _check_servo_exists(link, body.servo)
        if body.pulse_us is not None:
            return dict(await link.jog_pulse(body.servo, body.pulse_us))
        assert body.deg is not None  # one of both
        return dict(await link.jog(body.servo, body.deg))

    @routes.post("/pulse-limits")
    async def pulse_limits(body: PulseLimitBody) -> JsonObject:
        """Write the pulse that was found for a hobby servo into the face's own YAML."""
        _check_servo_exists(link, body.servo)
        config = (link.status or {}).get("config")
        async with one_at_a_time:
            return await asyncio.to_thread(
                set_pulse_limit, config, body.servo, body.limit, body.pulse_us
            )

    @routes.get("/faults")
    async def faults() -> JsonObject:
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
    async def calibration() -> JsonObject:
        """What the face's calibration file says: coverage and error of each joint, trims."""
        return await asyncio.to_thread(calibration_values, (link.status or {}).get("config"))

    @routes.get("/health")
    async def health() -> JsonObject:
        """Report to a monitor that the dashboard serves, and whether its face answers."""
        return {"serves": True, **link.certainty()}

    return routes


def _check_servo_exists(link: FaceLink, name: str) -> None:
    """Raise FaceError for a servo that the face lacks; pass while the face's servos are unknown."""
    known = list((link.status or {}).get("servos") or link.layout.servos)
    if known and name not in known:
        raise FaceError("not_found", f"no servo has that name; use one of {', '.join(known)}")


def file_routes(link: FaceLink) -> APIRouter:
    """Return the routes for settings, sound devices, a copy of a shipped face, and sound files."""
    routes = APIRouter(prefix="/api")
    uploads = Uploads()

    def status_text(name: str) -> str | None:
        value = (link.status or {}).get(name)
        return None if value is None else str(value)

    def lines() -> SoundLines:
        folder = status_text("sounds")
        return SoundLines(None if folder is None else Path(folder))

    @routes.get("/settings")
    async def settings() -> JsonObject:
        """Return settings. live: as set last; saved: in the face's own YAML, null if shipped."""
        shown = {"live": shown_settings(link.status), "config": status_text("config")}
        try:
            saved = await asyncio.to_thread(saved_settings, status_text("config"))
        except FaceError as error:
            return {**shown, "saved": None, "can_save": False, "why_not": str(error)}
        return {**shown, "saved": saved, "can_save": True, "why_not": None}

    @routes.patch("/settings")
    async def change(body: SettingsBody) -> JsonObject:
        """Change settings now; with `save`, in the YAML too: all of it or none."""
        return await change_settings(link, body.values, save=body.save)

    @routes.get("/sound")
    async def sound() -> JsonObject:
        """Loudspeakers, microphones, voices and languages to choose, and what is chosen."""
        return await asyncio.to_thread(sound_choices, status_text("config"))

    @routes.patch("/sound")
    async def choose(body: SoundBody) -> JsonObject:
        """Write choices into the face's own YAML; they count from its next start."""
        values = body.model_dump(exclude_none=True)
        return await asyncio.to_thread(choose_sound, status_text("config"), values)

    @routes.post("/copy", status_code=201)
    async def copy() -> JsonObject:
        """Copy a shipped face to a file of your own, which can be changed and started."""
        return await asyncio.to_thread(copy_shipped, status_text("config"))

    @routes.get("/lines")
    async def listed() -> JsonObject:
        """Return `lines`: the files in the face's folder of sounds, which it can play, by name.

        Each has `name`, `n_bytes` and `changed_s` (seconds since 1970); 1000 at most.
        """
        return {"lines": await asyncio.to_thread(lines().listed)}

    @routes.post("/lines", status_code=201, response_model=dict[str, Any])
    async def upload(request: Request, name: str, replace: bool = False) -> Any:
        """Store the body, a sound file as it is, under a name; at most 50 MB."""
        declared = request.headers.get("content-length", "")
        if declared.isdigit() and int(declared) > MOST_BYTES:
            raise HTTPException(413, f"the file has over {MOST_BYTES // 10**6} MB")
        place = lines().target_path(name)
        try:
            return await uploads.store(place, request.stream(), replace=replace)
        except ClientDisconnect:
            return JSONResponse({"error": "the client has gone"}, 400)

    @routes.delete("/lines/{name}")
    async def remove(name: str) -> JsonObject:
        """Delete one line, a sound file or performance."""
        await asyncio.to_thread(lines().remove, name)
        return {"removed": name}

    @routes.post("/play")
    async def play(body: PlayBody) -> JsonObject:
        """Play a line. Answered when it begins."""
        checked_name(body.file)
        if status_text("sounds") is not None:
            await asyncio.to_thread(lines().existing_path, body.file)
        return dict(await link.play(body.file))

    return routes


def shown_settings(status: Mapping[str, Any] | None) -> dict[str, float]:
    """Return a face's present settings by name, without mood and gaze; empty without status."""
    if status is None:
        return {}
    amount = (status.get("expression") or {}).get("expression")
    settings = dict(status.get("settings") or {})
    return settings if amount is None else {**settings, "expression": amount}


async def change_settings(link: FaceLink, values: dict[str, float], *, save: bool) -> JsonObject:
    """Change settings now, with `save` in the face's YAML too: all or none.

    Settings that only a restart changes are saved, not changed now. Returns `set`: the values that
    were changed now, `saved`: whether the YAML was written, and if so `at_restart`: names of values
    that count from the next start. Raises FaceError.
    """
    if not save:
        await link.change(values)
        return {"set": values, "saved": False}
    config = (link.status or {}).get("config")
    present = shown_settings(link.status)
    present.pop("lookahead_ms", None)  # part of the delay, which is fixed at the start
    edit = await asyncio.to_thread(with_settings, own_yaml(config), values)
    # What only a restart changes, such as the look-ahead, is saved and not set.
    settable = {name: value for name, value in values.items() if name in present}
    at_restart = [name for name in values if name not in present]
    if settable:
        await link.change(settable)
    try:
        with face_errors():
            await asyncio.to_thread(edit.write)
    except FaceError:
        if settable:  # back to the values before
            await link.change({name: float(present[name]) for name in settable})
        raise
    return {"set": settable, "saved": True, "at_restart": at_restart}
