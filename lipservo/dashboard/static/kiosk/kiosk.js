// The kiosk: what the face says, under it, and a screen that dims when nobody speaks or touches.
import { onFrame, onStatus } from "../link.js";
import { caption } from "../live/live_facts.js";

/** The screen dims when nobody has spoken or touched it for so long. */
const ASLEEP_AFTER_MS = 300_000;

class FaceCaption extends HTMLElement {
  connectedCallback() {
    this.kiosk = this.closest(".kiosk");
    // `/kiosk?text=none`: visitors listen, and nobody types.
    const asks = new URLSearchParams(location.search).get("text") !== "none";
    this.kiosk.classList.toggle("asks-hidden", !asks);
    this.wake = () => this.woken();
    addEventListener("pointerdown", this.wake);
    addEventListener("keydown", this.wake);
    this.undo = [
      onStatus((status) => this.tell(status)),
      onFrame((frame) => frame.speaking && this.woken()),
    ];
    this.woken();
    keepScreenOn();
  }

  disconnectedCallback() {
    this.undo.forEach((each) => each());
    removeEventListener("pointerdown", this.wake);
    removeEventListener("keydown", this.wake);
    clearTimeout(this.dims);
  }

  tell(status) {
    const words = caption(status);
    if (this.innerHTML !== words) this.innerHTML = words;
  }

  /** Make the screen bright, and let it dim ASLEEP_AFTER_MS from now. */
  woken() {
    this.kiosk.classList.remove("asleep");
    clearTimeout(this.dims);
    this.dims = setTimeout(() => this.kiosk.classList.add("asleep"), ASLEEP_AFTER_MS);
  }
}

/** Keep the computer's screen saver off; the request is repeated whenever the page is seen again. */
function keepScreenOn() {
  const ask = () => document.visibilityState === "visible" && navigator.wakeLock?.request("screen").catch(() => {});
  document.addEventListener("visibilitychange", ask);
  ask();
}

customElements.define("face-caption", FaceCaption);
