"""What a person moves on the pages, and what the face is asked for then."""

import json

import pytest
from places import ROOT

#: A minute of a real browser; CI runs it once.
pytestmark = pytest.mark.slow


def asked_of(page, path):
    """Bodies that the page sends to a path of the API from now on, each answered with {}."""
    bodies = []

    def answer(route):
        bodies.append(json.loads(route.request.post_data or "null"))
        route.fulfill(json={})

    page.route(f"**{path}", answer)
    return bodies


def wait_for(page, is_so):
    """Until something asked of the page has come here; a failing assertion says what has not."""
    for _ in range(100):
        if is_so():
            return
        page.wait_for_timeout(50)


def arm_and(page, script):
    """Arm the sliders, then run a script in the same moment.

    They disarm by themselves after 3 s, which a busy computer may need between two calls.
    """
    page.locator(".slider").first.wait_for()
    armed = "while (arm.ariaChecked !== 'true') await new Promise((done) => setTimeout(done, 5));"
    page.evaluate(
        "async () => { const arm = document.querySelector('face-jog .switch'); arm.click(); "
        + armed
        + script
        + " }"
    )


def slide(page, servo, deg):
    """As a hand does: the browser keeps a slider within its ends."""
    page.locator(f'.slider[data-servo="{servo}"] input').evaluate(
        "(input, deg) => { input.value = deg; input.dispatchEvent(new Event('input')); }", deg
    )


def test_sliders_move_nothing_until_they_are_armed(opened):
    page = opened("/servos")
    bodies = asked_of(page, "/api/jog")

    slide(page, "jaw", 5)
    page.wait_for_timeout(300)

    assert bodies == []
    assert page.evaluate("document.querySelector('face-jog .sliders').inert") is True


def test_an_armed_slider_moves_its_servo_within_its_limits_until_it_is_let_alone(opened):
    page = opened("/servos")
    bodies = asked_of(page, "/api/jog")

    arm_and(
        page,
        """
        const input = document.querySelector('.slider[data-servo="jaw"] input');
        input.value = 400;
        input.dispatchEvent(new Event('input'));
    """,
    )
    wait_for(page, lambda: len(bodies) == 2)
    assert bodies == [{"action": "arm"}, {"action": "move", "servo": "jaw", "deg": 25}]

    page.locator("face-jog .switch", has_text="Arm the sliders").wait_for(timeout=5000)
    slide(page, "jaw", 3)
    page.wait_for_timeout(300)
    assert len(bodies) == 2


def test_a_touch_renews_the_arming_at_the_face_too(opened):
    page = opened("/servos")
    bodies = asked_of(page, "/api/jog")

    arm_and(
        page,
        "document.querySelector('.slider input').dispatchEvent(new PointerEvent('pointerdown'));",
    )
    wait_for(page, lambda: len(bodies) == 2)

    assert bodies == [{"action": "arm"}, {"action": "arm"}]


def test_moves_that_the_face_refuses_do_not_keep_the_sliders_armed(opened):
    page = opened("/servos")
    asked_of(page, "/api/jog")
    arm_and(page, "")
    page.route("**/api/jog", lambda route: route.fulfill(status=422, json={"error": "not armed"}))

    page.evaluate(
        "setInterval(() => document.querySelector('face-jog').want('jaw', { deg: 1 }), 100)"
    )

    page.locator("face-jog .said", has_text="not armed").wait_for()
    page.locator("face-jog .switch", has_text="Arm the sliders").wait_for(timeout=5000)


def test_leaving_the_page_disarms(opened):
    page = opened("/servos")
    bodies = asked_of(page, "/api/jog")

    # As the browser says it when another page takes the place of this one.
    arm_and(page, "dispatchEvent(new PageTransitionEvent('pagehide'));")

    page.wait_for_function("document.querySelector('face-jog .sliders').inert")
    wait_for(page, lambda: len(bodies) == 2)
    assert bodies == [{"action": "arm"}, {"action": "end"}]


def test_a_reboot_is_asked_for_twice(opened):
    page = opened("/servos")
    bodies = asked_of(page, "/api/servos/jaw")
    button = page.locator('tr[data-servo="jaw"] .reboot')

    button.click()
    assert bodies == []
    page.locator("face-servo-table .said", has_text="Press again").wait_for()
    button.click()
    page.locator("face-servo-table .said", has_text="jaw restarts").wait_for()

    assert bodies == [{"action": "reboot"}]


def test_a_setting_changes_while_it_is_dragged_and_a_shipped_face_cannot_be_saved(opened, face):
    page = opened("/settings")
    slider = page.locator("input[name=strength]")
    slider.wait_for()

    slider.evaluate("(i) => { i.value = 0.5; i.dispatchEvent(new Event('input')); }")

    page.wait_for_function("dashboard.status.settings.strength === 0.5")
    assert face.commands.values["strength"] == 0.5
    assert page.locator("face-settings .save").is_disabled()
    assert "is shipped with lipservo" in page.inner_text("face-settings .where")


def test_settings_can_be_saved_once_the_face_has_told_where_its_yaml_is(opened):
    answers = [
        {"config": None, "can_save": False, "why_not": "try again"},
        {"config": "mine.yaml", "can_save": True, "why_not": None},
    ]
    page = opened()
    page.route(
        "**/api/settings", lambda route: route.fulfill(json=answers.pop(0) if answers else {})
    )
    page.goto(page.url.rstrip("/") + "/settings")

    page.locator("face-settings .save:enabled").wait_for()
    assert "writes them into mine.yaml" in page.inner_text("face-settings .where")


def test_a_value_between_the_steps_of_its_slider_is_saved_as_it_is(opened, face):
    face.commands.change({"strength": 0.82})

    def answer(route):
        if route.request.method == "GET":
            route.fulfill(json={"config": "mine.yaml", "can_save": True, "why_not": None})
        else:
            bodies.append(json.loads(route.request.post_data))
            route.fulfill(json={})

    bodies = []
    page = opened()
    page.route("**/api/settings", answer)
    page.goto(page.url.rstrip("/") + "/settings")
    page.wait_for_function("window.dashboard?.status?.settings?.strength === 0.82")
    page.locator("face-settings .save:enabled").click()
    wait_for(page, lambda: bodies)

    assert bodies[0]["values"]["strength"] == 0.82


def test_dragging_makes_it_look_there_and_letting_go_sets_it_free(opened):
    page = opened()
    bodies = asked_of(page, "/api/look-at")
    pad = page.locator("face-look .pad")
    pad.scroll_into_view_if_needed()
    box = pad.bounding_box()

    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.75, box["y"] + box["height"] * 0.25)
    wait_for(page, lambda: bodies and bodies[-1]["yaw_deg"] > 29)
    # The pad is seen from the front: its right is the robot's own left.
    assert bodies[-1] == pytest.approx({"yaw_deg": 30.0, "pitch_deg": 20.0}, abs=1)
    page.mouse.up()
    wait_for(page, lambda: bodies[-1] == {"yaw_deg": None})

    assert bodies[-1] == {"yaw_deg": None}


def test_a_face_without_a_voice_says_how_it_gets_one(opened):
    page = opened()

    page.locator("face-say .how", has_text="started without a voice").wait_for()
    assert page.locator("face-say form").is_hidden()


def test_lines_come_are_refused_and_go(opened, sounds):
    page = opened("/lines")
    clip = ROOT / "lipservo" / "clips" / "welcome.flac"

    page.set_input_files("face-lines input", str(clip))
    page.locator("li[data-file='welcome.flac']").wait_for()
    assert (sounds / "welcome.flac").read_bytes() == clip.read_bytes()

    bad = {"name": "noise.wav", "mimeType": "audio/wav", "buffer": b"this is no sound"}
    page.set_input_files("face-lines input", [bad])
    page.locator("face-lines .said[data-tone=bad]", has_text="noise.wav").wait_for()

    button = page.locator("li[data-file='welcome.flac'] .delete")
    button.click()
    assert (sounds / "welcome.flac").exists()
    button.click()
    page.locator("face-lines .files", has_text="No sound files").wait_for()
    assert not (sounds / "welcome.flac").exists()


def test_of_two_lines_only_the_one_that_plays_is_marked(opened, sounds):
    files = [sounds / "1.wav", sounds / "11.wav"]
    for file in files:
        file.touch()
    page = opened("/lines")
    page.locator("li[data-file='11.wav']").wait_for()
    for file in files:
        file.unlink()

    marked = "[...document.querySelectorAll('li.playing')].map((item) => item.dataset.file)"
    told = f"document.querySelector('face-lines').tell({{ speaking: '11.wav #3' }}); {marked}"
    assert page.evaluate(told) == ["11.wav"]


def test_what_is_said_of_lines_that_could_not_be_loaded_goes_with_the_next_that_could(opened):
    page = opened("/lines")
    page.route("**/api/lines", lambda route: route.fulfill(status=503, json={"error": "busy"}))
    page.evaluate("document.querySelector('face-lines').load()")
    said = page.locator("face-lines .said")
    said.and_(page.locator("[data-tone=bad]")).wait_for()
    page.unroute("**/api/lines")
    page.evaluate("document.querySelector('face-lines').load()")

    assert said.inner_text() == ""
