"""The API's settings and sound files."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fastapi import APIRouter, HTTPException, Request
from fastapi.responses import JSONResponse
from lipservo_client.face_answers import FaceError
from starlette.requests import ClientDisconnect

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.saved_settings import own_yaml, saved_settings, with_settings
from lipservo.dashboard.sound_lines import MOST_BYTES, SoundLines, checked_name
from lipservo.dashboard.uploads import Uploads
from lipservo.dashboard.web.api_models import PlayBody, SettingsBody

Told = dict[str, Any]


def file_routes(link: FaceLink) -> APIRouter:
    """Settings, live and saved; lines: list, upload, delete, play."""
    routes = APIRouter(prefix="/api")
    uploads = Uploads()

    def said(name: str) -> str | None:
        value = (link.status or {}).get(name)
        return None if value is None else str(value)

    def lines() -> SoundLines:
        folder = said("sounds")
        return SoundLines(None if folder is None else Path(folder))

    @routes.get("/settings")
    async def settings() -> Told:
        """live: as set last; saved: as the face's own YAML says, null for one that is shipped."""
        told = {"live": shown_settings(link.status), "config": said("config")}
        try:
            saved = await asyncio.to_thread(saved_settings, said("config"))
        except FaceError as error:
            return {**told, "saved": None, "can_save": False, "why_not": str(error)}
        return {**told, "saved": saved, "can_save": True, "why_not": None}

    @routes.patch("/settings")
    async def change(body: SettingsBody) -> Told:
        """Set them now; with `save`, into the YAML too: all of it or none."""
        return await change_settings(link, body.values, save=body.save)

    @routes.get("/lines")
    async def listed() -> Told:
        """The sound files that the face can play."""
        return {"lines": await asyncio.to_thread(lines().listed)}

    @routes.post("/lines", status_code=201, response_model=dict[str, Any])
    async def upload(request: Request, name: str, replace: bool = False) -> Any:
        """Store the body, a sound file as it is, under a name; at most 50 MB."""
        declared = request.headers.get("content-length", "")
        if declared.isdigit() and int(declared) > MOST_BYTES:
            raise HTTPException(413, f"more than {MOST_BYTES // 10**6} MB")
        place = lines().place_of(name)
        try:
            return await uploads.store(place, request.stream(), replace=replace)
        except ClientDisconnect:
            return JSONResponse({"error": "the client has gone"}, 400)

    @routes.delete("/lines/{name}")
    async def remove(name: str) -> Told:
        """Delete one."""
        await asyncio.to_thread(lines().remove, name)
        return {"removed": name}

    @routes.post("/play")
    async def play(body: PlayBody) -> Told:
        """Play a line. Answered when it begins."""
        checked_name(body.file)
        if said("sounds") is not None:
            await asyncio.to_thread(lines().path_of, body.file)
        return dict(await link.play(body.file))

    return routes


def shown_settings(status: Mapping[str, Any] | None) -> dict[str, float]:
    """What people set of a face, by name, as it is now; without wishes for the moment."""
    if status is None:
        return {}
    lively = (status.get("expression") or {}).get("expression")
    settings = dict(status.get("settings") or {})
    return settings if lively is None else {**settings, "expression": lively}


async def change_settings(link: FaceLink, values: dict[str, float], *, save: bool) -> Told:
    """Set them now; save: into the face's YAML as well. All of it, or none. Raises FaceError."""
    if not save:
        await link.change(values)
        return {"set": values, "saved": False}
    config = (link.status or {}).get("config")
    live = shown_settings(link.status)
    live.pop("lookahead_ms", None)  # part of the delay, which is declared at the start
    file = await asyncio.to_thread(with_settings, own_yaml(config), values)
    # What only a restart changes, such as the look-ahead, is saved and not set.
    now = {name: value for name, value in values.items() if name in live}
    at_restart = [name for name in values if name not in live]
    if now:
        await link.change(now)
    try:
        await asyncio.to_thread(file.write)
    except FaceError:
        if now:
            await link.change({name: float(live[name]) for name in now})
        raise
    return {"set": now, "saved": True, "at_restart": at_restart}
