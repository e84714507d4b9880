"""The dashboard's hold on a face: what it is told, and a face that goes, hangs or comes again."""

import asyncio
import contextlib
import math

import pytest
from lipservo_client.protocol import FaceError
from places import short_folder
from watched_face import LAYOUT, WatchedFace

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.web.api_models import StopBody
from lipservo.dashboard.web.stop_route import stop_face
from lipsync.errors import UserError


@contextlib.asynccontextmanager
async def linked(path):
    link = FaceLink(lambda: path)
    async with link.running():
        yield link


async def until(condition):
    async with asyncio.timeout(20.0):
        while not condition():
            await asyncio.sleep(0.01)


def test_it_knows_names_status_and_what_moves():
    async def watched(path):
        async with linked(path) as link:
            await until(
                lambda: (
                    link.answers and not link.snapshot.servos_gone and not link.snapshot.speech_gone
                )
            )
            assert link.layout == LAYOUT
            assert link.status["state"] == "driven"
            assert link.certainty()["up"]
            first = link.snapshot.number
            await until(lambda: link.snapshot.number > first + 5)
            assert len(link.history) > 5

    path = short_folder() / "tom.sock"
    with WatchedFace(path):
        asyncio.run(watched(path))


def test_a_face_that_ends_is_gone_and_one_that_comes_after_it_is_found():
    path = short_folder() / "tom.sock"

    async def watched():
        async with linked(path) as link:
            with WatchedFace(path):
                await until(lambda: link.answers and not link.snapshot.servos_gone)
            await until(lambda: not link.answers and link.snapshot.servos_gone)
            assert not link.certainty()["up"]
            with pytest.raises(FaceError, match="no face answers"):
                await stop_face(link, StopBody())
            with WatchedFace(path) as second:
                await until(lambda: link.answers and not link.snapshot.servos_gone)
                await stop_face(link, StopBody(level="limp"))
                await until(lambda: second.said == ["limp"])

    asyncio.run(watched())


def test_a_stop_finds_a_face_that_has_another_socket_by_now():
    folder = short_folder()
    paths = [folder / "one.sock", folder / "two.sock"]

    async def watched():
        link = FaceLink(lambda: next(path for path in paths if path.exists()))
        with WatchedFace(paths[0]) as first:
            await stop_face(link, StopBody())
            await until(lambda: first.said == ["soft"])
        with WatchedFace(paths[1]) as second:
            await stop_face(link, StopBody())
            await until(lambda: second.said == ["soft"])
        link.close()

    asyncio.run(watched())


def test_no_figure_that_is_no_number_is_handed_on():
    path = short_folder() / "tom.sock"

    async def watched():
        async with linked(path) as link:
            await until(lambda: link.answers)
            return link.status["health"]

    with WatchedFace(path, {"health": [{"name": "jaw", "load": math.nan, "n": math.inf}]}):
        assert asyncio.run(watched()) == [{"name": "jaw", "load": None, "n": None}]


def test_why_there_is_no_face_is_told():
    async def watched():
        def none():
            raise UserError("several faces run:\nchoose one")

        link = FaceLink(none)
        async with link.running():
            await until(lambda: "several" in link.trouble)
            assert link.trouble == "several faces run: choose one"

    asyncio.run(watched())
