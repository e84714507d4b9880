// A field to drag in: the robot looks there. The field is seen from the front, as the robot view
// is: dragging to the right makes it look to its own left.
import { postJson } from "../calls.js";
import { facts, onStatus } from "../link.js";
import { whyStill } from "../words.js";

const MOST_YAW_DEG = 60;
const MOST_PITCH_DEG = 40;
const EVERY_MS = 80; // a call while the one before has been answered, at most so often

class FaceLook extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<div class="pad" tabindex="0" role="application" aria-label="where the robot looks">' +
      '<i data-idle></i><span style="left:6px;top:4px">up</span>' +
      '<span style="right:6px;top:calc(50% + 4px)">its left</span>' +
      '<span style="left:6px;top:calc(50% + 4px)">its right</span></div>' +
      '<div class="row"><label><input type="checkbox" name="keep"> keep looking there</label>' +
      '<button type="button" class="act clear" disabled>Let it look around</button></div>' +
      '<p class="said" role="status"></p>';
    if (!canLook()) {
      this.innerHTML = '<p class="hint">This face has neither a neck nor eyes to look with.</p>';
      return;
    }
    this.pad = this.querySelector(".pad");
    this.spot = this.querySelector("i");
    this.keep = this.querySelector("[name=keep]");
    this.clearButton = this.querySelector(".clear");
    this.said = this.querySelector(".said");
    this.pad.addEventListener("pointerdown", (event) => {
      this.pad.setPointerCapture(event.pointerId);
      this.dragging = true;
      this.point(event);
    });
    this.pad.addEventListener("pointermove", (event) => this.dragging && this.point(event));
    for (const end of ["pointerup", "pointercancel"]) {
      this.pad.addEventListener(end, () => this.release());
    }
    this.pad.addEventListener("keydown", (event) => this.step(event));
    this.clearButton.addEventListener("click", () => this.clear());
    this.undo = onStatus((status) => this.still(whyStill(status)));
  }

  disconnectedCallback() {
    this.undo?.();
  }

  /** Lock the field while nothing can look. why: a sentence; null: it can. */
  still(why) {
    if (this.why === why) return;
    this.why = why;
    this.pad.inert = why !== null;
    this.said.dataset.tone = "";
    this.said.textContent = why ?? "";
  }

  point(event) {
    const { left, top, width, height } = this.pad.getBoundingClientRect();
    const across = Math.min(1, Math.max(-1, (2 * (event.clientX - left)) / width - 1));
    const down = Math.min(1, Math.max(-1, (2 * (event.clientY - top)) / height - 1));
    this.lookAt(across * MOST_YAW_DEG, -down * MOST_PITCH_DEG);
  }

  /** Move the target by an arrow key, 5 degrees, and keep it there. */
  step(event) {
    const steps = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] };
    const step = steps[event.key];
    if (!step) return;
    event.preventDefault();
    const [yaw, pitch] = this.target ?? [0, 0];
    this.keep.checked = true; // a key has no end, as a drag has
    this.lookAt(yaw + step[0], pitch + step[1]);
  }

  /** Aim at angles in degrees, limited to the field: show the spot there, and send the target. */
  lookAt(yaw, pitch) {
    this.target = [
      Math.min(MOST_YAW_DEG, Math.max(-MOST_YAW_DEG, yaw)),
      Math.min(MOST_PITCH_DEG, Math.max(-MOST_PITCH_DEG, pitch)),
    ];
    this.spot.style.left = `${50 + (50 * this.target[0]) / MOST_YAW_DEG}%`;
    this.spot.style.top = `${50 - (50 * this.target[1]) / MOST_PITCH_DEG}%`;
    delete this.spot.dataset.idle;
    this.clearButton.disabled = false;
    this.send();
  }

  release() {
    if (!this.dragging) return;
    this.dragging = false;
    if (!this.keep.checked) this.clear();
  }

  clear() {
    this.target = null;
    this.spot.dataset.idle = "";
    this.spot.style.left = this.spot.style.top = "50%";
    this.clearButton.disabled = true;
    this.send();
  }

  /** The newest target alone, once the call before has been answered. */
  async send() {
    if (this.sending) return;
    this.sending = true;
    let sent;
    while (sent !== this.target) {
      sent = this.target;
      try {
        await postJson("/api/look-at", sent ? { yaw_deg: sent[0], pitch_deg: sent[1] } : { yaw_deg: null });
        this.said.textContent = "";
      } catch (error) {
        this.said.dataset.tone = "bad";
        this.said.textContent = error.message;
      }
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
    this.sending = false;
  }
}

function canLook() {
  return Object.values(facts.rig ?? {}).some((one) => /^(neck|eye)_(yaw|pitch)$/.test(one.channel));
}

customElements.define("face-look", FaceLook);
