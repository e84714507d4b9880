"""A page with nothing on it but the twin, for tests in a browser: `python twin_page.py PORT`."""

import sys

from nicegui import app, ui

from lipservo.dashboard.twin.element import Twin, twin_routes
from lipsync.face.model import load_face

twin_routes(app, load_face())


@ui.page("/")
def page():
    Twin().style("width: 320px; height: 320px")


if __name__ == "__main__":
    ui.run(port=int(sys.argv[1]), host="127.0.0.1", show=False, reload=False)
