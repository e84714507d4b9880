"""A face that was stopped, as pages show it, and the way back: Start, behind a question."""

import os
import signal

import pytest

LINE = "#face-stop-report"
HEAD = "#face-state"
BANNER = "#face-banner"
START = "#face-start .begin"
QUESTION = "#face-start .question"
WHY = "#face-start .why"
LIMP = "at rest and limp, confirmed by 16 servos"
#: The second click of a double click is no answer: the page waits so long for one.
SURE_MS = 600

pytestmark = pytest.mark.slow


def reads(page, place, text):
    page.locator(place, has_text=text).wait_for(timeout=8000)


def stopped(page):
    """Stop the face by a key, until the page offers the way back."""
    page.keyboard.press("Escape")
    page.locator(START).wait_for(timeout=8000)
    reads(page, LINE, f"Stopped. {LIMP}")


def question(page):
    page.click(START)
    reads(page, QUESTION, "The face will move. Keep your hands away.")
    page.wait_for_timeout(SURE_MS)


def started(page, face):
    question(page)
    page.keyboard.press("Enter")
    reads(page, LINE, "Starting: the bridge starts")
    face.come_up()
    reads(page, HEAD, "running")


def wait_for(page, is_so):
    for _ in range(100):
        if is_so():
            return
        page.wait_for_timeout(50)
    pytest.fail("it did not come to that")


@pytest.mark.parametrize("has_bridge", [False, True])
def test_every_page_says_what_was_confirmed_and_raises_no_alarm(opened, startable, has_bridge):
    startable.has_bridge = has_bridge
    other, page = opened("/calibrate"), opened()

    stopped(page)

    reads(other, LINE, f"Stopped. {LIMP} at ")
    page.wait_for_timeout(1500)  # the servo side counts as gone after 0.8 s
    for each in (page, other):
        assert each.locator(BANNER).is_hidden()
        assert each.locator(HEAD).inner_text() == "stopped: limp"
        assert each.locator(START).is_visible()
    assert page.evaluate("robotView.drawn.unwell") == []
    assert page.locator('.strip[data-servo="jaw"] .value').inner_text().startswith("0.0")
    assert "Start it first" in page.inner_text("face-say")
    later = opened("/lines")
    reads(later, LINE, f"Stopped. {LIMP}. Start it again with Start.")  # when is not known to it


def test_start_is_confirmed_by_enter_and_the_next_stop_is_a_first_one(opened, startable):
    page = opened()
    stopped(page)
    page.click("#face-stop")
    reads(page, LINE, "Stopped. Limp, confirmed by 16 servos")
    page.wait_for_timeout(300)
    n_stops = len(startable.said)
    assert startable.said[-1] == "limp"

    started(page, startable)
    reads(page, LINE, "Started: the face is running.")
    page.keyboard.press("Escape")
    reads(page, LINE, LIMP)

    assert startable.starts == 1
    assert set(startable.said[n_stops:]) == {"soft"}


def test_escape_answers_the_question_with_stop(opened, startable):
    page = opened("/settings")
    stopped(page)
    n_stops = len(startable.said)
    question(page)

    page.keyboard.press("Escape")

    page.locator(QUESTION).wait_for(state="hidden")
    wait_for(page, lambda: len(startable.said) > n_stops)
    assert startable.starts == 0


def test_a_double_click_and_a_held_key_do_not_answer_the_question(opened, startable):
    page = opened("/lines")
    stopped(page)

    page.dblclick(START)
    page.keyboard.down("Enter")
    page.wait_for_timeout(SURE_MS)
    page.keyboard.down("Enter")  # it repeats

    assert page.locator(QUESTION).is_visible()
    page.click("#face-start .decline")
    assert page.locator(START).is_visible()
    assert startable.starts == 0


def test_stop_while_it_starts_stops_it(opened, startable):
    page = opened("/lines")
    stopped(page)
    question(page)
    page.click("#face-start .confirm")
    reads(page, HEAD, "starting")

    page.keyboard.press("Escape")

    reads(page, LINE, f"Stopped. {LIMP}")
    assert startable.state == "stopped"
    assert startable.said[-1] == "soft"


def test_a_start_that_overtakes_a_later_stop_is_stopped_again(opened, context, face):
    page = opened("/lines")
    stopped(page)
    held = []
    context.route("**/api/start", lambda route: held.append(route))
    question(page)
    page.click("#face-start .confirm")
    wait_for(page, lambda: held)
    page.keyboard.press("Escape")
    page.locator(START).wait_for(timeout=8000)

    answer = face.start()
    face.come_up()
    held[0].fulfill(json=answer)

    wait_for(page, lambda: face.state == "stopped")
    context.unroute("**/api/start")


def test_why_a_face_does_not_start(opened, startable):
    page = opened("/lines")
    stopped(page)
    refuse = {"error": "another face drives /dev/ttyUSB0"}
    page.route("**/api/start", lambda route: route.fulfill(status=409, json=refuse))
    question(page)
    page.keyboard.press("Enter")
    reads(page, WHY, "Not started: another face drives /dev/ttyUSB0")
    assert page.locator(START).is_visible()
    page.unroute("**/api/start")

    question(page)
    page.keyboard.press("Enter")
    reads(page, HEAD, "starting")
    startable.troubles = ["servo jaw: its model is another"]
    reads(page, LINE, "Servo jaw: its model is another.")
    startable.stop("limp")

    reads(page, WHY, "Not started. Servo jaw: its model is another.")
    reads(page, LINE, "Stopped. Limp, confirmed by 16 servos")


def test_two_pages_end_with_the_same_word(opened, startable):
    one, other = opened("/lines"), opened("/settings")
    stopped(one)
    other.locator(START).wait_for()

    started(one, startable)
    other.keyboard.press("Escape")

    for page in (one, other):
        reads(page, LINE, f"Stopped. {LIMP}")
        reads(page, HEAD, "stopped: limp")
    # A start from elsewhere: both follow it.
    startable.start()
    for page in (one, other):
        reads(page, LINE, "Starting: the bridge starts")
    startable.come_up()
    for page in (one, other):
        reads(page, HEAD, "running")
        page.locator(LINE).wait_for(state="hidden", timeout=8000)


def test_servos_that_did_not_confirm_are_named_on_every_page(opened, startable):
    startable.unconfirmed = {"jaw": "does not answer"}
    page = opened("/servos")

    page.keyboard.press("Escape")

    reads(page, HEAD, "stopped: NOT confirmed limp")
    reads(
        page, LINE, "NOT confirmed to be limp: jaw (does not answer). Keep your hands away. Switch"
    )
    reads(page, 'tr[data-servo="jaw"] .state', "NOT confirmed limp")
    reads(page, 'tr[data-servo="lids"] .state', "limp")
    later = opened("/servos")
    reads(later, LINE, "NOT confirmed to be limp: jaw (does not answer)")


def test_sliders_of_a_stopped_face_are_disabled_with_the_reason(opened, startable):
    page = opened("/servos")
    stopped(page)

    reads(page, "face-jog .hint", "The face is stopped. Start it first")
    assert page.locator("face-jog .switch").is_disabled()
    reads(page, 'tr[data-servo="jaw"] .state', "limp")
    page.locator('tr[data-servo="jaw"] .reboot:disabled').wait_for()

    started(page, startable)
    reads(page, "face-jog .hint", "While armed")
    assert page.locator("face-jog .switch").is_enabled()


def test_a_dashboard_that_is_gone_leaves_the_last_confirmed_word(opened, startable, dashboard):
    page = opened("/lines")
    stopped(page)
    os.kill(dashboard[1].pid, signal.SIGSTOP)
    try:
        reads(page, LINE, f"The dashboard does not answer any more. The servos' last word: {LIMP}")
        page.locator(BANNER).wait_for(state="hidden")
        assert page.locator(START).is_hidden()

        page.keyboard.press("Escape")
        reads(page, LINE, f"Trying again (1) … The servos' last word: {LIMP}")
        assert "supply" not in page.inner_text("#face-head")
        assert "may still move" not in page.inner_text("#face-head")
    finally:
        os.kill(dashboard[1].pid, signal.SIGCONT)
    reads(page, LINE, "Stopped. Limp, confirmed by 16 servos")  # by the second press

    # Once it is driven again, the word is no longer kept.
    startable.start()
    startable.come_up()
    reads(page, HEAD, "running")
    os.kill(dashboard[1].pid, signal.SIGSTOP)
    try:
        reads(page, BANNER, "The face may still move")
    finally:
        os.kill(dashboard[1].pid, signal.SIGCONT)
    page.locator(BANNER).wait_for(state="hidden", timeout=8000)


def test_a_word_is_forgotten_however_often_stop_is_pressed(opened, startable):
    page = opened("/lines")
    stopped(page)
    page.wait_for_timeout(1600)  # frames that are late may still say "driven"
    page.route("**/api/stop", lambda route: route.abort())
    page.keyboard.press("Escape")
    reads(page, LINE, f"The servos' last word: {LIMP}")

    startable.start()
    startable.come_up()
    for _ in range(4):
        page.wait_for_timeout(400)
        page.keyboard.press("Escape")

    reads(page, LINE, "Switch the servos' supply off")
    page.unroute("**/api/stop")


def test_a_face_that_has_ended_was_confirmed_limp_and_how_to_start_it(browser, face, served):
    face.is_daemon = False
    with served(face.path, "--listen", "127.0.0.1:0") as (address, process):
        page = browser.new_page()
        page.goto(f"{address}/lines")
        page.wait_for_function("window.dashboard?.frame")
        page.keyboard.press("Escape")
        reads(page, LINE, f"The face has ended: {LIMP}")
        process.terminate()
        process.wait()

        page.wait_for_timeout(2500)
        assert LIMP in page.inner_text(LINE)
        assert "with `lipservo daemon --config face_head --dashboard`" in page.inner_text(LINE)
        assert page.inner_text(HEAD) == "ended: limp"
        assert page.locator(BANNER).is_hidden()
        page.close()


def test_a_face_whose_port_or_supply_is_gone_is_not_called_driven(opened, face):
    page = opened("/lines")
    face.states = dict.fromkeys(face.names, "waiting")
    reads(page, HEAD, "no servo answers: look at their supply")

    face.plugged = False
    reads(page, HEAD, "port gone: look at the plug")


def test_a_page_without_its_token_says_what_to_open(opened):
    page = opened("/lines")
    page.route("**/api/status", lambda route: route.fulfill(status=401, json={"error": "token"}))

    reads(page, BANNER, "open the address that was printed, or run `lipservo dashboard --open`")
    reads(page, HEAD, "not let in")
