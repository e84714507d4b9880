import asyncio
import threading
from dataclasses import replace

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from unpacked_head import unpack

from lipservo.dashboard.twin.element import HEAD_PATH, PackedHead, twin_routes
from lipsync import errors
from lipsync.face.model import load_face
from lipsync.twin.packed import pack
from lipsync.twin.twin import make_twin


@pytest.fixture(scope="module")
def get():
    """What the route answers to a request with these headers."""
    app = FastAPI()
    twin_routes(app, load_face())

    async def asked(headers):
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://face") as client:
            return await client.get(HEAD_PATH, headers=headers)

    return lambda **headers: asyncio.run(
        asked({n.replace("_", "-"): v for n, v in headers.items()})
    )


def test_the_head_is_served_compressed_and_as_it_was_packed(get):
    answer = get()

    assert answer.headers["content-encoding"] == "gzip"
    assert len(unpack(answer.content)["skin"]["triangles"]) == 29_184
    assert int(answer.headers["content-length"]) < 1_300_000


def test_the_head_that_ships_is_that_of_the_model_that_ships(get):
    """A page makes none, which needs scipy; `packed_head` of the lab packs it anew."""
    kept, made = unpack(get().content), unpack(pack(make_twin(load_face())))
    for name, part in made.items():
        np.testing.assert_array_equal(kept[name]["triangles"], part["triangles"])
        np.testing.assert_allclose(kept[name]["places_mm"], part["places_mm"], atol=1e-3)
        for morph, moves in part["morphs"].items():
            np.testing.assert_allclose(kept[name]["morphs"][morph], moves, atol=1e-2)


def test_a_model_of_ones_own_without_scipy_is_told_what_to_install(monkeypatch):
    monkeypatch.setattr(errors, "find_spec", lambda _: None)
    face = load_face()
    own = replace(face, mean_mm=face.mean_mm + 0.5)
    app = FastAPI()
    twin_routes(app, own)
    transport = httpx.ASGITransport(app=app)
    client = httpx.AsyncClient(transport=transport, base_url="http://face")
    with pytest.raises(errors.MissingExtraError, match="lipservo\\[fit\\]"):
        asyncio.run(client.get(HEAD_PATH))


def test_a_browser_that_has_it_is_told_so(get):
    tag = get().headers["etag"]

    answer = get(if_none_match=tag)

    assert answer.status_code == 304
    assert answer.content == b""
    assert get(if_none_match='"another"').status_code == 200


def test_who_takes_no_gzip_gets_none(get):
    packed = get().content

    answer = get(accept_encoding="identity")

    assert "content-encoding" not in answer.headers
    assert answer.content == packed


def test_the_head_is_made_once_and_in_a_thread_of_its_own():
    makers = []

    def make():
        makers.append(threading.current_thread())
        return b"head"

    head = PackedHead(make)

    assert head.get() == head.get()
    (maker,) = makers
    assert maker is not threading.current_thread()


def test_whoever_asks_for_a_head_that_cannot_be_made_is_told_why():
    def fail():
        raise OSError("no mean face")

    head = PackedHead(fail)

    for _ in range(2):
        with pytest.raises(OSError, match="no mean face"):
            head.get()
