// The sound that belongs to what the mouth shows: loudest sample of every 10 ms, four seconds.
import { LONGEST_SPAN_S, colour, fitted, shownTimeS, spanS } from "./canvas.js";
import { frameAgeMs, onFrame, onPaint } from "../link.js";

const BLOCK_S = 0.01;
const GAP_S = 0.15;
const N_KEPT = Math.ceil((LONGEST_SPAN_S + 0.5) / BLOCK_S);

class FaceWaveform extends HTMLElement {
  connectedCallback() {
    this.times = new Float64Array(N_KEPT).fill(-Infinity);
    this.peaks = new Float32Array(N_KEPT);
    this.next = 0;
    this.lastS = -Infinity;
    this.innerHTML = '<canvas role="img" aria-label="loudness of the last four seconds"></canvas>';
    this.canvas = this.firstChild;
    this.undo = [onFrame((frame) => this.take(frame)), onPaint((frame) => this.draw(frame))];
    window.waveform = this;
  }

  disconnectedCallback() {
    this.undo.forEach((each) => each());
  }

  /** Keep the peaks of a frame with their times, in a ring of N_KEPT. */
  take(frame) {
    frame.peaks.forEach((peak, i) => {
      // Blocks are 10 ms apart, whenever their frames come; only after a gap a frame's time counts.
      const dueS = frame.timeS - (frame.peaks.length - 1 - i) * BLOCK_S;
      const nextS = this.lastS + BLOCK_S;
      this.lastS = Math.abs(nextS - dueS) < GAP_S ? nextS : dueS;
      this.times[this.next] = this.lastS;
      this.peaks[this.next] = peak;
      this.next = (this.next + 1) % N_KEPT;
    });
  }

  /** Draw the peaks of the last seconds, red where the sound is at full scale. */
  draw(frame) {
    const { context, width, height } = fitted(this.canvas);
    const nowS = shownTimeS(frame, frameAgeMs());
    const pxPerS = width / spanS(width);
    const middle = height / 2;
    context.clearRect(0, 0, width, height);
    context.fillStyle = colour(this.canvas, "edge");
    context.fillRect(0, middle - 0.5, width, 1);
    const blue = colour(this.canvas, "blue");
    const wide = Math.max(1.5, pxPerS * BLOCK_S - 0.7);
    for (let i = 0; i < N_KEPT; i += 1) {
      const ageS = nowS - this.times[i];
      if (!(ageS >= -GAP_S && ageS <= LONGEST_SPAN_S) || this.peaks[i] === 0) continue;
      // The square root shows quiet speech too: 1 % of full scale is a tenth of the height.
      const reach = Math.sqrt(this.peaks[i]) * (middle - 3);
      context.fillStyle = this.peaks[i] > 0.995 ? "#c81e1e" : blue;
      context.fillRect(width - ageS * pxPerS, middle - reach, wide, 2 * reach);
    }
  }
}

customElements.define("face-waveform", FaceWaveform);
