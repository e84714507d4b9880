// A text for the face to say; where it has no voice, how to give it one.
import { postJson } from "../calls.js";
import { onStatus } from "../link.js";
import { whyStill } from "../words.js";

const HOW =
  "This face was started without a voice. Start it as <code>lipservo daemon --config FACE " +
  "--play --dashboard</code> and it says what you type here.";

/** Lips shut, bitten, rounded and wide in each. */
const EXAMPLES = ["My name is Pepper.", "Five blue bees move my lips.", "How warm is it by the window?"];

class FaceSay extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<form><input class="field" name="text" maxlength="2000" autocomplete="off" ' +
      'aria-label="a text to say" placeholder="Good morning, I am the robot.">' +
      '<button class="act first">Say</button></form>' +
      `<p class="examples">Try: ${EXAMPLES.map((text) => `<button type="button" class="act">${text}</button>`).join(" ")}</p>` +
      `<p class="hint how" hidden>${HOW}</p><p class="said" role="status"></p>`;
    this.form = this.querySelector("form");
    this.how = this.querySelector(".how");
    this.said = this.querySelector(".said");
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.say(this.form.elements.text.value.trim());
    });
    this.examples = this.querySelector(".examples");
    this.examples.addEventListener("click", (event) => {
      if (event.target.matches("button")) this.say(event.target.textContent);
    });
    this.undo = onStatus((status) => this.tell(status));
  }

  disconnectedCallback() {
    this.undo();
  }

  tell(status) {
    const still = whyStill(status);
    const canSay = still === null && Boolean(status?.listens_on);
    this.form.hidden = this.examples.hidden = !canSay;
    this.how.hidden = canSay || status === null;
    const text = still ?? HOW;
    if (this.how.innerHTML !== text) this.how.innerHTML = text;
  }

  async say(text) {
    if (!text) return;
    const button = this.form.querySelector("button");
    button.disabled = true;
    this.show("", "Asking for it …");
    try {
      await postJson("/api/say", { text }, { patienceMs: 20000 });
      this.form.reset();
      this.show("good", `It says: ${text}`);
    } catch (error) {
      this.show("bad", error.message);
    }
    button.disabled = false;
  }

  show(tone, text) {
    this.said.dataset.tone = tone;
    this.said.textContent = text;
  }
}

customElements.define("face-say", FaceSay);
