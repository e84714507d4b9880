// A text for the face to say, and by which voice; where it has no voice, how to give it one.
import { getJson, postJson } from "../calls.js";
import { onStatus } from "../link.js";
import { escaped, whyStill } from "../words.js";

const HOW =
  "This face was started without a voice. Start it as <code>lipservo daemon --config FACE " +
  "--play --dashboard</code> and it says what you type here.";

/** Lips shut, bitten, rounded and wide in each. */
const EXAMPLES = ["My name is Pepper.", "Five blue bees move my lips.", "How warm is it by the window?"];

/** As the voice was made. */
const USUAL = { rate_wpm: 175, pitch: 50 };

/** HTML options of languages, each by its own name, sorted by these; first the face's language, `own`. Pure. */
export function languageOptions(tags, own) {
  const nameOf = (tag) => {
    try {
      return new Intl.DisplayNames([tag], { type: "language", fallback: "code" }).of(tag);
    } catch {
      return tag; // a tag of the synthesiser's that is none of the standard's
    }
  };
  const named = tags.map((tag) => [tag, nameOf(tag)]).sort((one, other) => one[1].localeCompare(other[1]));
  const options = named.map(([tag, name]) => `<option value="${escaped(tag)}">${escaped(name)}</option>`);
  return `<option value="">${escaped(own ? nameOf(own) : "usual language")}</option>${options.join("")}`;
}

class FaceSay extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<form><input class="field" name="text" maxlength="2000" autocomplete="off" ' +
      'aria-label="a text to say" placeholder="Good morning, I am the robot.">' +
      '<select class="field language" name="language" aria-label="language" hidden></select>' +
      '<button class="act first">Say</button></form>' +
      '<details class="voice" hidden><summary>Voice</summary><div class="choices">' +
      '<label>Voice<select class="field" name="voice"></select></label>' +
      `<label>Speed<input type="range" name="rate_wpm" min="80" max="400" value="${USUAL.rate_wpm}"></label>` +
      `<label>Pitch<input type="range" name="pitch" min="0" max="99" value="${USUAL.pitch}"></label></div></details>` +
      `<p class="examples">Try: ${EXAMPLES.map((text) => `<button type="button" class="act">${text}</button>`).join(" ")}</p>` +
      `<p class="hint how" hidden>${HOW}</p><p class="said" role="status"></p>`;
    this.form = this.querySelector("form");
    this.voice = this.querySelector(".voice");
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

  /** Show the form while the face can speak, else why it cannot. */
  tell(status) {
    const still = whyStill(status);
    const canSay = still === null && Boolean(status?.listens_on);
    this.form.hidden = this.examples.hidden = !canSay;
    this.voice.hidden = !canSay || !this.told;
    if (canSay && !this.asked) this.ask();
    this.how.hidden = canSay || status === null;
    const text = still ?? HOW;
    if (this.how.innerHTML !== text) this.how.innerHTML = text;
  }

  /** Request languages and voices once, when the face can speak, and make the choices of the form. */
  async ask() {
    this.asked = true;
    const told = await getJson("/api/sound", 20000).catch(() => null);
    if (!told?.languages) return;
    const { language } = this.form.elements;
    language.innerHTML = languageOptions(told.languages, told.chosen.language);
    language.hidden = told.languages.length < 2;
    const voices = ["", ...told.voices].map((name) => `<option value="${escaped(name)}">${escaped(name || "its own choice")}</option>`);
    this.voice.querySelector("select").innerHTML = voices.join("");
    this.told = true;
    this.voice.hidden = this.form.hidden;
  }

  /** The options that differ from the face's own voice, as /api/say takes them. */
  chosen() {
    const options = { language: this.form.elements.language.value };
    options.voice = this.voice.querySelector("select").value;
    for (const { name, value } of this.voice.querySelectorAll("input")) {
      if (Number(value) !== USUAL[name]) options[name] = Number(value);
    }
    return Object.fromEntries(Object.entries(options).filter(([, value]) => value !== ""));
  }

  /** Let the face say a text, and show whether it was accepted. */
  async say(text) {
    if (!text) return;
    const button = this.form.querySelector("button");
    button.disabled = true;
    this.show("", "Asking for it …");
    try {
      await postJson("/api/say", { text, ...this.chosen() }, { patienceMs: 20000 });
      this.form.elements.text.value = "";
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
