// The phonemes of the last four seconds, as the mouth shows them; now is at the right.
import { LONGEST_SPAN_S, colour, fitted, shownTimeS, spanS } from "./canvas.js";
import { facts, frameAgeMs, onFrame, onPaint } from "../link.js";

/** Add a frame's phoneme to `runs`, {phoneme, fromS, toS} each, oldest first; drop old ones. Changes `runs`. */
export function extend(runs, timeS, phoneme, keptS = LONGEST_SPAN_S) {
  const last = runs.at(-1);
  if (last && timeS < last.toS) runs.length = 0; // the dashboard was started again
  if (last && last.phoneme === phoneme) last.toS = timeS;
  else {
    if (last) last.toS = timeS;
    runs.push({ phoneme, fromS: timeS, toS: timeS });
  }
  while (runs.length && runs[0].toS < timeS - keptS - 0.5) runs.shift();
  return runs;
}

class FaceTimeline extends HTMLElement {
  connectedCallback() {
    this.runs = [];
    this.innerHTML = '<canvas role="img" aria-label="phonemes of the last four seconds"></canvas>';
    this.canvas = this.firstChild;
    this.undo = [
      onFrame((frame) => extend(this.runs, frame.timeS, frame.phoneme)),
      onPaint((frame) => this.draw(frame)),
    ];
    window.timeline = this;
  }

  disconnectedCallback() {
    this.undo.forEach((each) => each());
  }

  /** Draw lines for seconds, and a block for each run of a phoneme but silence; now is at the right edge. */
  draw(frame) {
    const { context, width, height } = fitted(this.canvas);
    const nowS = shownTimeS(frame, frameAgeMs());
    const pxPerS = width / spanS(width);
    context.clearRect(0, 0, width, height);
    drawSeconds(context, nowS, pxPerS, width, height);
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const [i, run] of this.runs.entries()) {
      const name = run.phoneme;
      if (!name || name === "SIL") continue;
      const isLast = i === this.runs.length - 1;
      const left = width - (nowS - run.fromS) * pxPerS;
      const right = isLast ? width : width - (nowS - run.toS) * pxPerS;
      drawRun(context, name, left, right, height);
    }
  }
}

/** Draw a vertical line at each whole second before `nowS`. */
function drawSeconds(context, nowS, pxPerS, width, height) {
  context.strokeStyle = colour(context.canvas, "line");
  context.lineWidth = 1;
  for (let s = Math.floor(nowS); s > nowS - LONGEST_SPAN_S; s -= 1) {
    const x = Math.round(width - (nowS - s) * pxPerS) + 0.5;
    context.beginPath();
    context.moveTo(x, 0);
    context.lineTo(x, height);
    context.stroke();
  }
}

/** Draw a phoneme's block in its group's colour, with its name where that fits. */
function drawRun(context, name, left, right, height) {
  const group = facts.phonemeGroups?.[name] ?? "other";
  const [fill, ink] = facts.groupColours?.[group] ?? ["#e3e8ed", "#15202b"];
  const wide = Math.max(2, right - left - 1.5);
  context.fillStyle = fill;
  context.beginPath();
  context.roundRect(left, 3, wide, height - 6, Math.min(5, wide / 2));
  context.fill();
  if (wide < 11) return;
  context.fillStyle = ink;
  context.font = `600 ${wide < 24 ? 13 : 17}px Roboto, sans-serif`;
  context.fillText(name, left + wide / 2, height / 2 + 1);
}

customElements.define("face-timeline", FaceTimeline);
