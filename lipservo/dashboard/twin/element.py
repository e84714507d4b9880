"""The twin as a NiceGUI element."""

import nicegui.elements.scene  # noqa: F401  registers three.js for the page, which twin.js loads
from nicegui.element import Element

from lipservo.dashboard.twin.routes import HEAD_PATH


class Twin(Element, component="twin.js", esm={"lipservo-twin": "picture"}):
    """A head that shows frames. Its place on the page decides its size: give it a height.

    In the page, `window.twin.apply(frame)` shows a frame of static/frame.js, the newest at the next
    redraw; `window.twin` says what is shown (picture/index.js). One twin a page.
    """

    def __init__(self, source: str = HEAD_PATH) -> None:
        super().__init__()
        self._props["source"] = source
        self.style("width: 100%; min-height: 240px")
