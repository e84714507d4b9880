"""The server of a study as a browser meets it: one item after the other, kept before confirmed."""

import errno
import os

import httpx
import pytest
from lipservo_lab.study.answers import AnswerFile, read_answers
from lipservo_lab.study.serving import StudyDesk, minutes_of, study_app, study_token
from lipservo_lab.study.sheets import ANSWERS_FILE
from small_study import served_app, write_small_study

from lipsync.errors import UserError

RATER = "0123456789ab"
AS_RATER = {"authorization": "Bearer secret"}


def opened(address, headers=None):
    return httpx.Client(base_url=address, timeout=20.0, trust_env=False, headers=headers)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("study")
    write_small_study(path, films=False)
    return path


@pytest.fixture
def served(folder, tmp_path):
    """(client with the token, file of answers, study)."""
    from lipservo_lab.study.sheets import read_study

    study = read_study(folder)
    with AnswerFile(tmp_path / ANSWERS_FILE, study.identity) as answers:
        app = study_app(StudyDesk(study, answers, minutes_of(study)), folder, "secret")
        with served_app(app) as address, opened(address, AS_RATER) as client:
            yield client, answers, study


def joined(client):
    return client.post("/api/raters", json={"rater": RATER, "agrees": True}).json()


def fitting(item):
    answers = {"reading": "bin blue", "sound": item["expected"], "pair": "A"}
    return answers.get(item["kind"], 3)


def send(client, item, answer, **more):
    body = {"number": item["number"], "answer": answer, "seconds": 2.5, "plays": 1, **more}
    return client.post(f"/api/raters/{RATER}/answers", json=body)


def test_a_rater_gets_every_item_once_and_goes_on_where_they_were(served):
    client, answers, study = served
    item, seen = joined(client), []
    while item["number"] is not None:
        seen.append(item["number"])
        item = send(client, item, fitting(item)).json()
        assert client.get(f"/api/raters/{RATER}").json() == item

    assert seen == list(range(len(study.sheets[0])))
    kept = read_answers(answers.path, study.identity).raters[RATER].answers
    assert list(kept) == seen


def test_consent_is_asked_for_and_its_text_says_how_long_it_takes(served):
    client, answers, study = served
    about = client.get("/api/study").json()
    refused = client.post("/api/raters", json={"rater": RATER})

    assert "MINUTES" not in about["consent"]
    assert len(about["scale"]) == 5
    assert (refused.status_code, answers.raters) == (422, {})
    assert minutes_of(study) >= 1


def test_an_answer_that_is_sent_again_is_confirmed_and_another_is_not_taken(served):
    client, answers, _ = served
    item = joined(client)
    first = send(client, item, "lay red")
    again = send(client, item, "lay red")
    other = send(client, item, "set blue")

    assert first.json() == again.json()
    assert other.status_code == 409
    assert len(answers.rater(RATER).answers) == 1


@pytest.mark.parametrize(
    "body",
    [
        {"number": 0, "answer": 3, "seconds": 1, "plays": 1},
        {"number": 0, "answer": "x" * 501, "seconds": 1, "plays": 1},
        {"number": 999, "answer": "x", "seconds": 1, "plays": 1},
        {"number": True, "answer": "x", "seconds": 1, "plays": 1},
        {"number": 0, "answer": "x", "seconds": -1, "plays": 1},
        {"number": 0, "answer": "x", "seconds": 1},
        {},
        [],
        "text",
        {"number": 0, "answer": "x" * 9000, "seconds": 1, "plays": 1},
    ],
)
def test_what_is_no_answer_is_refused_in_one_line_and_not_kept(served, body):
    client, answers, _ = served
    joined(client)
    refused = client.post(f"/api/raters/{RATER}/answers", json=body)

    assert refused.status_code == 422
    assert refused.json()["error"]
    assert "\n" not in refused.json()["error"]
    assert answers.rater(RATER).answers == {}


def test_on_a_full_disk_the_page_is_told_and_its_next_try_counts(served, monkeypatch):
    client, answers, _ = served
    item = joined(client)

    def full(_fd):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        refused = send(client, item, "lay")
    assert refused.status_code == 507
    assert "No space left on device" in refused.json()["error"]
    assert answers.rater(RATER).answers == {}
    assert send(client, item, "lay").json()["number"] == 1


def test_a_clip_is_served_in_parts_and_one_that_vanished_is_named(served, folder):
    client, _, study = served
    first, second, *_ = study.duration_s
    path = folder / "served/clips" / f"{second}.mp4"
    path.unlink()

    part = client.get(f"/clips/{first}.mp4", headers={"range": "bytes=0-0"})
    gone = client.get(f"/clips/{second}.mp4")
    path.write_bytes(b"0")
    assert (part.status_code, part.content) == (206, b"0")
    assert (gone.status_code, gone.json()) == (404, {"error": f"clip {second} is missing"})
    assert client.get("/clips/..%2F..%2F..%2Fkey.json").status_code == 404


def test_without_the_token_nothing_is_shown_and_the_address_with_it_gets_a_cookie(served):
    client, *_ = served
    with opened(client.base_url) as stranger:
        for path in ("/", "/api/study", "/study.js", f"/api/raters/{RATER}"):
            assert stranger.get(path).status_code == 401
        assert "token" in stranger.get("/").text
        came = stranger.get("/", params={"token": "secret"})
        assert (came.status_code, came.headers["location"]) == (303, "/")
        page = stranger.get("/")
        assert page.status_code == 200
        assert "default-src 'self'" in page.headers["content-security-policy"]


def test_a_page_loads_nothing_from_elsewhere(served):
    client, *_ = served
    for path in ("/", "/study.js", "/study.css"):
        assert "//" not in client.get(path).text.replace("// ", "").replace("</", "")


def test_a_rater_who_leaves_is_asked_nothing_more(served):
    client, answers, _ = served
    joined(client)
    assert client.post(f"/api/raters/{RATER}/leave", json={}).json() == {"left": True}
    assert client.get(f"/api/raters/{RATER}").json()["number"] is None
    assert answers.rater(RATER).has_left
    assert client.get("/api/raters/unknown").status_code == 404


def test_the_token_of_a_study_is_its_own_and_stays(tmp_path):
    token = study_token(tmp_path)

    assert study_token(tmp_path) == token
    assert len(token) >= 16
    assert (tmp_path / "token").stat().st_mode & 0o077 == 0
    (tmp_path / "token").write_text("\n")
    with pytest.raises(UserError, match="is empty; delete it"):
        study_token(tmp_path)
