"""What a newcomer meets on the page: a text to say, what it speaks with, and no barrier."""

import pytest

pytestmark = pytest.mark.slow

PAGES = ("/", "/show", "/kiosk", "/servos", "/calibrate", "/lines", "/settings")
SOUND = {
    "inputs": [], "outputs": ["USB Audio"], "synthesizers": ["espeak", "piper"], "voices": [],
    "languages": ["de", "en-us"], "is_shipped": False,
    "chosen": {"output": None, "input": None, "synthesizer": "espeak", "voice": "",
               "language": "", "volume": 0.5},
}  # fmt: skip


@pytest.mark.parametrize("colors", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1440])
@pytest.mark.parametrize("path", PAGES)
def test_a_page_has_no_serious_barrier(path, width, colors, opened):
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed"
    )
    page = opened(path)
    page.emulate_media(color_scheme=colors)
    page.set_viewport_size({"width": width, "height": 844})
    found = axe.Axe().run(page).response["violations"]

    assert [
        (each["id"], each["nodes"][0]["html"])
        for each in found
        if each["impact"] in ("serious", "critical")
    ] == []


@pytest.mark.parametrize("size", [(390, 844), (1440, 900)])
def test_the_text_box_is_seen_without_scrolling(size, opened):
    page = opened()
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.locator("face-say form, face-say .how").locator("visible=true").first.wait_for()
    box = page.locator("face-say").bounding_box()

    assert box["y"] + box["height"] < size[1]


def test_an_example_is_said_by_one_press(opened, face):
    face.listens_on = "127.0.0.1:8765"
    page = opened()
    page.route("**/api/say", lambda route: route.fulfill(json={}))
    with page.expect_request("**/api/say") as asked:
        page.locator("face-say .examples button").first.evaluate("button => button.click()")

    assert asked.value.post_data_json == {"text": "My name is Pepper."}


def test_a_choice_of_sound_is_written_at_once_and_a_shipped_face_is_copied_first(opened):
    page = opened()
    told = dict(SOUND)
    page.route(
        "**/api/sound",
        lambda route: route.fulfill(
            json=told if route.request.method == "GET" else {"in": "a.yaml"}
        ),
    )
    page.click("face-sound summary")
    page.locator("face-sound select[name=output]").wait_for()
    with page.expect_request(lambda request: request.method == "PATCH") as asked:
        page.select_option("face-sound select[name=output]", "USB Audio")
    assert asked.value.post_data_json == {"output": "USB Audio"}
    page.locator("face-sound .said", has_text="Saved in a.yaml.").wait_for()

    told["is_shipped"] = True
    page.reload()
    page.click("face-sound summary")
    page.route(
        "**/api/copy", lambda route: route.fulfill(json={"file": "/x/my.yaml", "command": "y"})
    )
    page.click("face-sound .copy")
    page.locator("face-sound .said", has_text="Saved as /x/my.yaml. Start it: y").wait_for()
    assert page.locator("face-sound select").first.is_disabled()
