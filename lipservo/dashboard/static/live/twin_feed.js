// Every new frame to the twin, once its element is there; it shows the newest at its next redraw.
import { onDraw } from "../link.js";

onDraw((frame) => window.twin?.apply(frame));
