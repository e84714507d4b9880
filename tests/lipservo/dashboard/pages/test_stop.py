"""STOP, as a person presses it: whatever else of the page works or does not."""

import pytest

REPORT = "#face-stop-report"

pytestmark = pytest.mark.slow


def reported(page, text):
    page.locator(REPORT, has_text=text).wait_for(timeout=20_000)


def test_stop_says_what_the_servos_confirmed_and_a_second_press_lets_go(opened, face):
    page = opened()

    page.click("#face-stop")
    reported(page, "at rest and limp, confirmed by 16 servos")
    page.click("#face-stop")
    reported(page, "Stopped. Limp, confirmed by 16 servos")

    assert set(face.said) == {"soft", "limp"}
    assert face.said[0] == "soft"


def test_a_servo_that_does_not_confirm_is_named(opened, face):
    face.unconfirmed = {"jaw": "did not answer"}
    page = opened()

    page.click("#face-stop")

    reported(page, "NOT confirmed to be limp: jaw (did not answer). Keep your hands away. Switch")


@pytest.mark.parametrize("path", ["/", "/servos", "/calibrate", "/lines", "/settings"])
def test_escape_stops_on_every_page(opened, face, path):
    page = opened(path)

    page.keyboard.press("Escape")

    reported(page, "confirmed by 16 servos")
    assert face.said[0] == "soft"


def test_stop_works_while_the_framework_of_the_page_cannot_be_loaded(browser, address, face):
    with browser.new_context() as context:
        page = context.new_page()
        page.route("**/_nicegui/**/*.js", lambda _route: None)  # they never come
        page.route("**/static/link.js", lambda route: route.abort())
        page.goto(address, wait_until="commit")

        page.click("#face-stop")

        reported(page, "confirmed by 16 servos")
    assert face.said[0] == "soft"


def test_a_press_before_any_script_has_come_stops_the_face_and_is_told_of_later(
    browser, address, face
):
    held = []
    with browser.new_context() as context:
        page = context.new_page()
        page.route("**/*.js", lambda route: held.append(route))
        page.goto(address, wait_until="commit")

        with page.expect_response("**/api/stop") as asked:
            page.click("#face-stop")
        assert asked.value.ok
        assert asked.value.request.post_data_json == {"level": "soft", "wait_s": 0}

        for route in held:
            route.continue_()
        reported(page, "confirmed by 16 servos")
    assert set(face.said) == {"soft"}


def test_stop_tries_again_and_says_so_while_nobody_answers(opened, face):
    page = opened()
    page.route("**/api/stop", lambda route: route.abort())

    page.click("#face-stop")
    reported(page, "The dashboard does not answer. Trying again")
    reported(page, "Switch the servos' supply off")
    page.unroute("**/api/stop")

    reported(page, "confirmed by 16 servos")
    assert face.said[0] == "soft"
