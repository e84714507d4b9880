"""What a browser on this computer gets without the token: STOP, which works, and how to get in."""

from functools import cache
from pathlib import Path
from typing import Final

#: The script of STOP on every page; it imports nothing.
_SCRIPT: Final = Path(__file__).parent.parent / "static" / "stop.js"
_PAGE: Final = """<!doctype html><html lang="en"><meta charset="utf-8"><title>lipservo: STOP</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body{font:1.1rem/1.5 system-ui,sans-serif;max-width:40rem;margin:3rem auto;padding:0 1rem}
#face-stop{font-size:2rem;padding:1.5rem 3rem;border:0;border-radius:.8rem;background:#c8102e;
color:#fff;cursor:pointer}#face-stop small{display:block;font-size:1rem}
#face-stop-report{font-weight:600}#face-stop-report[data-tone=good]{color:#176b2c}
#face-stop-report[data-tone=bad]{color:#c8102e}
</style>
<h1>lipservo</h1>
<p><button id="face-stop" type="button" title="Stops the face. Pressed again: limp at once.">
<b>STOP</b><small>Esc</small></button></p>
<p id="face-stop-report" role="alert" hidden></p>
<p>The page itself needs the face's token: open the address that was printed when the face started
(it ends in <code>?token=…</code>), or run <code>lipservo dashboard --open</code>.</p>
<script type="module">%s</script></html>
"""


@cache
def stop_page() -> str:
    """The page, with the script of STOP in it: without the token no file is served."""
    script = _SCRIPT.read_text("utf-8")
    return _PAGE.replace("%s", script.replace("</script", "<\\/script"), 1)
