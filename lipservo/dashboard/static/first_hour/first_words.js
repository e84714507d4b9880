// The face runs as its daemon does, and says its first line.
import "../live/live_facts.js";
import { escaped } from "../words.js";
import { draw } from "./dom.js";

export class FirstWords {
  static title = "First words";

  constructor(hour, body) {
    Object.assign(this, { hour, body });
    body.addEventListener("click", (event) => this.click(event.target.closest("button")));
  }

  can(state) {
    return Boolean(state.face?.calibration);
  }

  summary() {
    return "";
  }

  /** Draw the section: why it must wait, a button that starts the face, or the face that runs. */
  update(state) {
    if (!this.can(state)) {
      draw(this.body, "<p>A face speaks once it is calibrated.</p>");
      return;
    }
    if (!this.hour.runs("speak")) {
      // After a start that failed, perhaps for want of a sound card, sound is not preselected.
      const silent = state.step?.name === "speak" && state.step.error;
      draw(
        this.body,
        `<p>${escaped(state.face.name)} knows its servos, their limits and a mouth. The face will move: keep your hands away.</p>` +
          `<label class="check"><input type="checkbox" name="play"${silent ? "" : " checked"}> with sound, on this computer's loudspeaker</label>` +
          `<button type="button" class="act first" data-do="start">Start the face</button>${after(state)}`,
      );
      return;
    }
    draw(
      this.body,
      '<div class="speaking"><div><face-robot></face-robot></div><div class="say-side"><face-say></face-say><face-facts></face-facts></div></div>' +
        `<div class="buttons end"><a class="act" href="/">See it live</a><button type="button" class="act" data-do="end">Let it rest</button></div>${after(state)}`,
    );
  }

  click(button) {
    if (button?.dataset.do === "start") {
      this.hour.post("start", { step: "speak", play: this.body.querySelector("[name=play]").checked });
    } else if (button?.dataset.do === "end") this.hour.post("end");
  }
}

/** How the face is started from now on, and what is made. */
function after(state) {
  const { file } = state;
  const port = state.simulated ? ` --port ${state.port}` : "";
  return (
    `<p class="hint">From now on without this page: <code>lipservo daemon --config ${escaped(file)}${escaped(port)} --play --dashboard</code></p>`
  );
}
