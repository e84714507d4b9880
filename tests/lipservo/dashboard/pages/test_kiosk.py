"""The kiosk's page: the face on the whole screen, what it says, STOP, and a box for a text."""

import pytest

pytestmark = pytest.mark.slow

SOUND = {
    "inputs": [], "outputs": [], "synthesizers": ["espeak"], "voices": [],
    "languages": ["de", "en-us", "ja"], "is_shipped": True,
    "chosen": {"output": None, "input": None, "synthesizer": "espeak", "voice": "",
               "language": "", "volume": 0.5},
}  # fmt: skip


def stand_in(page, **status):
    """A face with a voice, whose statuses have these values, and the choices of `SOUND`."""
    status = {"listens_on": "ws://127.0.0.1:8765", **status}

    def answer(route):
        route.fulfill(json={**route.fetch().json(), **status})

    page.route("**/api/status", answer)
    page.route("**/api/sound", lambda route: route.fulfill(json=SOUND))


@pytest.mark.parametrize("size", [(390, 844), (3840, 2160)])
def test_face_stop_and_captions_fill_any_screen_and_nothing_else_is_there(size, opened):
    page = opened("/kiosk")
    page.set_viewport_size({"width": size[0], "height": size[1]})
    stand_in(page, words=["Five", "blue", "bees"], word=1)
    page.locator("face-caption b", has_text="blue").wait_for()

    assert page.locator("face-caption").inner_text() == "Five blue bees"
    head = page.locator(".kiosk .head").bounding_box()
    assert (head["width"], head["height"]) == size
    for shown in ("#face-stop", "face-caption", "face-say form"):
        box = page.locator(shown).bounding_box()
        assert 0.0 <= box["x"] <= size[0] - box["width"]
        assert 0.0 <= box["y"] <= size[1] - box["height"]
    assert page.locator("#face-head nav").is_hidden()
    assert page.evaluate("document.scrollingElement.scrollHeight <= innerHeight")
    caption, asks = (page.locator(each).bounding_box() for each in ("face-caption", ".asks"))
    assert caption["y"] + caption["height"] <= asks["y"]


def test_a_text_is_said_in_the_language_that_is_chosen_by_its_own_name(opened):
    page = opened("/kiosk")
    stand_in(page)
    page.reload()
    page.locator("face-say .language option", has_text="Deutsch").wait_for(state="attached")
    page.route("**/api/say", lambda route: route.fulfill(json={}))
    page.locator("face-say .language").select_option("de")
    page.locator("face-say [name=rate_wpm]").evaluate("each => (each.value = 120)")
    page.locator("face-say [name=text]").fill("Guten Tag")
    with page.expect_request("**/api/say") as asked:
        page.locator("face-say form button").click()

    wanted = {"text": "Guten Tag", "language": "de", "rate_wpm": 120}
    assert asked.value.post_data_json == wanted


def test_visitors_who_only_listen_see_no_box(opened):
    page = opened("/kiosk?text=none")
    page.locator("face-caption").wait_for(state="attached")

    assert page.locator("face-say").is_hidden()
    assert page.locator("#face-stop").is_visible()


@pytest.mark.parametrize(
    ("words", "caption"),
    [
        (["今", "天", "天", "气"], "今天天气"),
        (["Привет", "мир"], "Привет мир"),
        (["こんにちは世界", "3", "月"], "こんにちは世界 3 月"),
    ],
)
def test_words_of_scripts_without_spaces_stand_together(module_page, words, caption):
    told = module_page.evaluate(
        "async words => (await import('/static/live/live_facts.js')).caption({ words })", words
    )

    assert told == caption
