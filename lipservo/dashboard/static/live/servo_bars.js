// Goal against encoder, one strip a servo: blue bar = where it is, orange tick = where it should be.
import { drawnDeg, face, facts, onDraw, onHello, troubleOf } from "../link.js";
import { shown, spoken, unread } from "../words.js";

/** Where an angle lies on a strip from least to most, 0..1, kept inside. Pure. */
export function place(deg, leastDeg, mostDeg) {
  return Math.min(1, Math.max(0, (deg - leastDeg) / (mostDeg - leastDeg || 1)));
}

class FaceServoBars extends HTMLElement {
  connectedCallback() {
    this.rows = [];
    this.undo = [
      onHello((hello) => this.build(hello.servos)),
      onDraw((frame) => this.draw(frame)),
    ];
  }

  disconnectedCallback() {
    this.undo.forEach((each) => each());
  }

  build(names) {
    this.replaceChildren(...names.map((name) => strip(name)));
    this.rows = names.map((name, i) => {
      const row = this.children[i];
      const find = (selector) => row.querySelector(selector);
      return { name, row, bar: find(".bar"), goal: find(".goal"), value: find(".value") };
    });
  }

  /** Show each servo's measured angle as a bar from 0, its goal as a tick, and what is wrong with it. */
  draw(frame) {
    const encodersDeg = drawnDeg(frame);
    for (const [i, { name, row, bar, goal, value }] of this.rows.entries()) {
      const { least_deg: least, most_deg: most } = limits(name);
      const encoder = encodersDeg[i];
      const trouble = troubleOf(name, encoder);
      row.classList.toggle("unwell", trouble !== null);
      row.classList.toggle("limp", !frame.torqueOn);
      const zero = place(0, least, most);
      const at = encoder === null ? zero : place(encoder, least, most);
      bar.style.transform = `translateX(${100 * Math.min(zero, at)}%) scaleX(${Math.abs(at - zero)})`;
      goal.style.left = `${100 * place(frame.goalsDeg[i], least, most)}%`;
      const text = encoder === null ? unread(face.status, name, trouble === null) : shown(encoder, 1, "°");
      if (value.textContent !== text) value.textContent = text;
      row.title = trouble === null ? "" : `${spoken(name)}: ${trouble}`;
    }
  }
}

function limits(name) {
  return facts.servos?.[name] ?? { least_deg: -90, most_deg: 90, positive: "" };
}

/** The element of a servo's strip, its ends and zero at their places. */
function strip(name) {
  const { least_deg: least, most_deg: most, positive } = limits(name);
  const row = document.createElement("div");
  row.className = "strip";
  row.dataset.servo = name;
  row.innerHTML =
    '<span class="name"></span><span class="track"><i class="bar"></i><i class="zero"></i>' +
    '<i class="goal"></i></span><span class="value"></span>' +
    `<span class="ends"><span>${least}°</span><em></em><span>${most}°</span></span>`;
  row.querySelector(".name").textContent = spoken(name);
  row.querySelector(".ends em").textContent = positive ? `+ ${positive}` : "";
  row.querySelector(".zero").style.left = `${100 * place(0, least, most)}%`;
  return row;
}

customElements.define("face-servo-bars", FaceServoBars);
