"""The frame of every page: head with state and STOP, links to other pages, styles and facts.

The head is plain HTML before the element that the page's framework draws into, and STOP's script
is loaded first and imports nothing: STOP works while the rest of the page does not.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from typing import Any, Final

from nicegui import ui

#: Where `lipservo/dashboard/static/` is served.
STATIC_URL: Final = "/static"
#: The page of the setup of a new face; other faces have no such page.
FIRST_HOUR: Final = "/first-hour"
#: Title of each page by its path.
PLACES: Final = {
    FIRST_HOUR: "First hour",
    "/": "Live",
    "/show": "Show",
    "/kiosk": "Kiosk",
    "/servos": "Servos",
    "/calibrate": "Calibrate",
    "/lines": "Lines",
    "/settings": "Settings",
}
#: Scripts of all pages, in this order; STOP first.
_ALWAYS: Final = ("stop.js", "link.js", "stopped.js", "watchdog.js")
#: Modules that these scripts import: requested at once, not one after the other.
_IMPORTED: Final = ("frame.js", "calls.js", "words.js")


#: What STOP does until stop.js has loaded; stop.js then repeats the stop, and shows its result.
_EARLY_STOP: Final = (
    "if(!window.faceStop){this.dataset.pressed=this.dataset.early='';"
    "fetch('/api/stop',{method:'POST',headers:{'Content-Type':'application/json'},"
    "body:JSON.stringify({level:'soft',wait_s:0})})}"
)

#: The button that starts a stopped face, and a question before it moves; stopped.js shows them.
_START: Final = (
    '<div id="face-start" hidden><p class="why" role="alert" hidden></p>'
    '<button type="button" class="act first begin">Start</button>'
    '<div class="question" role="group" aria-labelledby="face-start-question" hidden>'
    '<b id="face-start-question">The face will move. Keep your hands away.</b>'
    '<button type="button" class="act decline">Leave it stopped</button>'
    '<button type="button" class="act first confirm">Start now</button></div></div>'
)


@contextmanager
def page_frame(
    here: str, status: Mapping[str, Any] | None, facts: Mapping[str, object], scripts: Sequence[str]
) -> Iterator[None]:
    """Draw the frame of the page at path `here`, and enter it for the page's content.

    status: the face's newest, None before its first answer; only its name and port are used, since
    the page's scripts request the rest. facts: of the face, for these scripts (`page_facts`).
    scripts: files of static/ that the page loads.
    """
    ui.page_title(f"{PLACES[here]} · {(status or {}).get('name') or 'lipservo'}")
    # The framework writes no language into its page; readers of screens need it.
    ui.add_head_html('<script>document.documentElement.lang = "en"</script>')
    ui.add_head_html(f'<link rel="stylesheet" href="{STATIC_URL}/dashboard.css">')
    places = {path: title for path, title in PLACES.items() if path != FIRST_HOUR}
    if facts.get("firstHour"):
        places = {FIRST_HOUR: PLACES[FIRST_HOUR], **places}
    ui.add_body_html(_header_html(here, status or {}, places))
    ui.add_body_html(
        f'<script type="application/json" id="face-facts">{_script_json(facts)}</script>'
    )
    for module in _IMPORTED:
        ui.add_head_html(f'<link rel="modulepreload" href="{STATIC_URL}/{module}">')
    # `async`: without it these scripts would wait for those of the framework.
    for script in (*_ALWAYS, *scripts):
        ui.add_body_html(f'<script type="module" async src="{STATIC_URL}/{script}"></script>')
    with ui.element("div").classes("face-page").mark(f"page {PLACES[here]}"):
        yield


@contextmanager
def card(title: str, hint: str = "", classes: str = "") -> Iterator[None]:
    """Draw a card with a heading, and enter it for its content. hint: a sentence beside it.

    classes: CSS classes of the card.
    """
    with ui.element("section").classes(f"card {classes}".strip()):
        aside = f"<small>{escape(hint)}</small>" if hint else ""
        html(f"<h2>{escape(title)}</h2>{aside}", "card-head")
        yield


def grid(classes: str) -> ui.element:
    """Return a new element of the page, whose children the CSS `classes` arrange."""
    return ui.element("div").classes(classes)


def html(text: str, classes: str = "", tag: str = "div") -> None:
    """Draw HTML unsanitised: never pass text of a user or a file that is not escaped.

    classes: CSS classes; tag: of the element that has the text.
    """
    ui.html(text, sanitize=False, tag=tag).classes(classes)


def command(text: str) -> str:
    """Return a command line as HTML that wraps between words alone, never after a hyphen."""
    words = (f'<span class="word">{escape(word)}</span>' for word in text.split(" "))
    return f"<pre><code>{' '.join(words)}</code></pre>"


def _header_html(here: str, status: Mapping[str, Any], places: Mapping[str, str]) -> str:
    """Return HTML of the header of a page: face, port, links to all pages, and the stop button.

    here: the page's own path. places: titles of pages by path.
    """
    name = escape(str(status.get("name") or "no face yet"))
    port = status.get("port")
    port_html = '<span class="port sim">SIMULATED</span>'
    if port:
        port_html = f'<span class="port">{escape(str(port))}</span>'
    elif not status:
        port_html = ""
    links = "".join(
        f'<a href="{path}"{" aria-current=page" if path == here else ""}>{title}</a>'
        for path, title in places.items()
    )
    return (
        '<div id="face-head"><header>'
        f'<div class="who"><h1 id="face-name">{name}</h1>{port_html}'
        '<span id="face-state" role="status">…</span></div>'
        f"<nav>{links}</nav>"
        f'<button id="face-stop" type="button" onclick="{_EARLY_STOP}"'
        ' title="Stops the face. Pressed again: limp at once.">'
        "<b>STOP</b><small>Esc</small></button></header>"
        f'<div id="face-word"><p id="face-stop-report" role="alert" hidden></p>{_START}</div>'
        '<p id="face-banner" role="alert" hidden></p></div>'
    )


def _script_json(value: Mapping[str, object]) -> str:
    """Return `value` as JSON that cannot end a script element, whatever text it contains."""
    return json.dumps(value).replace("<", "\\u003c")
