"""A study in a real browser: a script rates 40 clips, and everything dies in the middle."""

import json
import shutil
import signal
from collections import Counter
from urllib.parse import urlsplit

import pytest
from lipservo_lab.study.answers import read_answers
from lipservo_lab.study.sheets import ANSWERS_FILE, Size
from small_study import served_study, write_small_study

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
#: As tests/lipservo/dashboard/pages has them; clips play without a click of a person.
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--no-first-run", "--disable-quic", "--autoplay-policy=no-user-gesture-required",
)  # fmt: skip
SHORT = Size(ratings=4, pairs=1, readings=4, sentences=4, checks=0, sheets=2)
_PATIENCE_MS = 30_000
_NUMBER = "document.querySelector('main').dataset.number"

#: Two minutes of a real browser.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def playwright():
    if CHROMIUM is None:
        pytest.skip("no chromium on this computer: apt install chromium")
    module = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with module.sync_playwright() as driver:
        yield driver


@pytest.fixture
def browse(playwright, tmp_path):
    """Opens the browser of one person, who keeps what it keeps; (context, page)."""

    def opened(address):
        context = playwright.chromium.launch_persistent_context(
            tmp_path / "browser", executable_path=CHROMIUM, args=FLAGS
        )
        page = context.pages[0]
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(address)
        return context, page

    return opened


def kind_of(page):
    page.wait_for_function("document.querySelector('main').dataset.kind")
    return page.eval_on_selector("main", "main => main.dataset.kind")


_CLICK_NUMBER = """number => {
    const main = document.querySelector("main");
    if (main.dataset.kind !== "sound") return;
    [...main.querySelectorAll("button")].find(each => each.textContent === number).click();
}"""


def begin(page):
    page.check("#agree")
    page.click("#start")
    kind_of(page)


def watch(page):
    """Every clip of the item, to its end."""
    for n in range(page.locator(".clip").count()):
        page.locator(".clip button").nth(n).click()
        page.wait_for_function(f"document.querySelectorAll('video')[{n}].ended")


def answer(page, kind):
    """Does what is asked, and clicks an answer."""
    if kind == "sound":
        page.click("#beeps")
        for n in range(1, 7):  # looked at and clicked at once: the right one brings the next item
            page.evaluate(_CLICK_NUMBER, f"{n}")
        return
    if kind == "check":
        page.locator(".scale button").nth(int(page.inner_text("h1")[-2]) - 1).click()
        return
    watch(page)
    match kind:
        case "rating":
            page.locator(".scale button").nth(3).click()
        case "pair":
            page.get_by_text("B is more natural").click()
        case "reading":
            page.fill("textarea", "bin blue at f 2 now")
            page.click("main button.main")


def answer_until(page, number=None):
    """Answers until an item is shown, or to the end."""
    while (kind := kind_of(page)) != "end":
        at = int(page.eval_on_selector("main", "main => main.dataset.number"))
        if at == number:
            return
        answer(page, kind)
        page.wait_for_function(
            f"{_NUMBER} !== '{at}' || document.querySelector('main').dataset.kind === 'end'"
        )


def test_forty_clips_are_rated_though_server_and_browser_die_in_the_middle(tmp_path, browse):
    folder = tmp_path / "study"
    folder.mkdir()
    study, _ = write_small_study(folder)
    n_clips = sum(len(item.clips) for item in study.sheets[0])
    with served_study(folder) as (address, server):
        context, page = browse(address)
        begin(page)
        answer_until(page, 14)
        watch(page)
        # The server is shot, then an answer is given: the page holds it and says so.
        server.send_signal(signal.SIGKILL)
        server.wait()
        page.locator(".scale button").nth(1).click()
        page.locator("#trouble", has_text="Your answers are safe").wait_for()
        port = urlsplit(address).port
    with served_study(folder, f"127.0.0.1:{port}") as (again, server):
        page.wait_for_function(f"{_NUMBER} === '15'")
        assert page.locator("#trouble").is_hidden()
        answer_until(page, 20)
        # Now the browser is closed in an answer that nobody confirms.
        server.send_signal(signal.SIGSTOP)
        watch(page)
        page.locator(".scale button").nth(2).click()
        context.close()
        server.send_signal(signal.SIGCONT)
        context, page = browse(again)
        page.wait_for_function(f"{_NUMBER} === '21'")
        answer_until(page)
        assert "All your answers are kept" in page.inner_text("main")
        context.close()

    lines = [json.loads(line) for line in (folder / ANSWERS_FILE).read_bytes().splitlines()]
    given = Counter(line["number"] for line in lines if line["kind"] == "answer")
    (rater,) = read_answers(folder / ANSWERS_FILE, study.identity).raters.values()
    assert n_clips == 40
    assert given == dict.fromkeys(range(len(study.sheets[0])), 1)
    assert (rater.answers[14]["answer"], rater.answers[20]["answer"]) == (2, 3)
    assert {line["kind"] for line in lines} == {"study", "join", "answer"}


def test_a_clip_cannot_be_judged_before_it_was_seen_and_the_next_person_begins_anew(
    tmp_path, browse
):
    folder = tmp_path / "study"
    folder.mkdir()
    study, _ = write_small_study(folder, SHORT)
    with served_study(folder) as (address, _):
        context, page = browse(address)
        assert page.locator("#start").is_disabled()
        begin(page)
        while kind_of(page) != "rating":
            at = page.eval_on_selector("main", "main => main.dataset.number")
            answer(page, kind_of(page))
            page.wait_for_function(f"{_NUMBER} !== '{at}'")
        assert page.locator(".scale button:enabled").count() == 0
        page.keyboard.press("4")
        watch(page)
        assert page.locator(".scale button:enabled").count() == 5
        page.keyboard.press("4")
        page.wait_for_function(f"{_NUMBER} === '6'")
        answer_until(page)
        page.click("#next")
        page.locator("#agree").wait_for()
        begin(page)
        context.close()
    raters = read_answers(folder / ANSWERS_FILE, study.identity).raters

    assert sorted(rater.sheet for rater in raters.values()) == [0, 1]
    assert [rater.answers.get(5, {}).get("plays") for rater in raters.values()] == [1, None]
