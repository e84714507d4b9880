// Where the servos are, which of them moves what, and the face's YAML.
import { escaped, spoken } from "../words.js";
import { draw } from "./dom.js";

const NAMES = [
  "jaw", "upper_lip", "upper_lip_left", "upper_lip_right", "lower_lip", "lower_lip_left", "lower_lip_right",
  "corner_left_out", "corner_right_out", "corner_left_up", "corner_right_up", "lip_protrusion",
  "neck_yaw", "neck_pitch", "eye_yaw", "eye_pitch", "lid_left", "lid_right", "brow_left", "brow_right",
];
const WORDS = ["opens", "closes", "raises", "lowers", "widens", "narrows", "protrudes", "retracts", "turns left", "turns right", "nods up", "nods down"];
const DID = {
  opens: "opened", closes: "closed", raises: "rose", lowers: "sank", widens: "widened", narrows: "narrowed",
  protrudes: "came forward", retracts: "went back", "turns left": "turned left", "turns right": "turned right",
  "nods up": "nodded up", "nods down": "nodded down",
};
const PARTS = { mouth: "the mouth", neck: "the neck", eyes: "the eyes", lids: "the lids", brows: "the brows", tongue: "the tongue", other: "something else" };
const KINDS = { dynamixel: "Dynamixel", feetech: "Feetech", maestro: "Pololu Maestro, hobby servos", pca9685: "PCA9685, hobby servos" };

export class Servos {
  static title = "Servos";

  constructor(hour, body) {
    Object.assign(this, { hour, body, id: null });
    body.addEventListener("click", (event) => this.click(event.target.closest("button")));
    body.addEventListener("submit", (event) => {
      event.preventDefault();
      this.submit(event.target, event.submitter);
    });
    body.addEventListener("change", (event) => this.change(event.target));
  }

  can(state) {
    return state.face === null; // a face that is there is never written over
  }

  summary(state) {
    if (state.face) return `${Object.keys(state.face.servos).map(spoken).join(", ")}: in ${state.file.split("/").at(-1)}`;
    return state.found ? `${Object.keys(state.found.servos).length} found at ${state.port}` : "";
  }

  /** Draw the section: servos being searched, hobby servos, servos that were found, or the choice of a port. */
  update(state) {
    if (this.hour.runs("find")) {
      const where = state.simulated ? "the simulated port" : escaped(state.port);
      draw(this.body, `<p class="busy"><i></i>Asking who is at ${where}, at every rate. This takes up to a minute; nothing moves.</p>`);
    } else if (state.kind && state.kinds[state.kind]) draw(this.body, this.wired(state));
    else if (state.found) this.found(state);
    else draw(this.body, ports(state));
  }

  /** Draw the servos that were found: a chip for each, and a form that names the one that is chosen. */
  found(state) {
    const { servos, foreign } = state.found;
    if (Object.keys(foreign).length) {
      draw(this.body, strangers(foreign));
      return;
    }
    const ids = Object.keys(servos);
    const unnamed = ids.filter((id) => !state.named[id]);
    if (this.id === null || !ids.includes(this.id)) this.id = unnamed[0] ?? null;
    const chips = ids
      .map((id) => {
        const named = state.named[id];
        const text = named ? `${spoken(named.name)} <small>${escaped(named.positive)}</small>` : "not named";
        return `<button type="button" class="chip${id === this.id ? " now" : ""}${named ? " done" : ""}" data-id="${id}"><small>id ${id}</small> ${text}</button>`;
      })
      .join("");
    const file = escaped(state.file.split("/").at(-1));
    const footer = unnamed.length
      ? `<p class="hint">${ids.length - unnamed.length} of ${ids.length} named.</p>`
      : `<p>All ${ids.length} servos have a name. The face gets careful limits of 10° to either side; the real ones come next.</p>` +
        `<button type="button" class="act first" data-do="write">Write ${file}</button>`;
    const form = this.id === null ? "" : this.form(state, servos[this.id]);
    draw(this.body, `<div class="chips">${chips}</div>${form}${footer}`);
    const busy = this.hour.runs("nudge");
    for (const button of this.body.querySelectorAll("button")) button.disabled = busy;
    if (this.id === null) return;
    const isMoved = state.moved.includes(Number(this.id));
    this.body.querySelector(".after").hidden = !isMoved || busy;
    const move = this.body.querySelector("[data-do=move]");
    move.textContent = busy ? "It moves …" : isMoved ? "Move it once more" : "Move it by 3° and back";
    move.classList.toggle("first", !isMoved);
    this.change();
  }

  /** HTML of the form that names the chosen servo; its fields are shown once the servo has moved. */
  form(state, model) {
    const named = state.named[this.id] ?? { name: "", positive: "opens", part: "mouth", sign: 1 };
    const words = [...new Set([...WORDS, named.positive])];
    const option = (value, text, chosen) => `<option value="${escaped(value)}"${value === chosen ? " selected" : ""}>${escaped(text)}</option>`;
    return (
      `<form class="naming" data-form="name"><p class="lead">Servo <b>id ${this.id}</b> <small>${escaped(model)}</small></p>` +
      '<p>Look at the face, keep your hands away, and let it move: which joint is it?</p>' +
      '<button type="button" class="act first" data-do="move">Move it by 3° and back</button>' +
      '<div class="after" hidden><div class="fields">' +
      `<label>The joint's name<input class="field" name="name" list="joint-names" maxlength="40" autocomplete="off" autocapitalize="off" placeholder="jaw" value="${escaped(named.name)}"></label>` +
      `<label>A positive angle<select class="field" name="positive">${words.map((word) => option(word, word, named.positive)).join("")}</select></label>` +
      `<label>It moves<select class="field" name="part">${Object.entries(PARTS).map(([part, text]) => option(part, text, named.part)).join("")}</select></label>` +
      `</div><datalist id="joint-names">${NAMES.map((name) => `<option value="${name}">`).join("")}</datalist>` +
      '<p class="question">And its first move?</p><div class="buttons">' +
      '<button type="submit" class="act" name="same" value="yes">It <b class="did">opened</b></button>' +
      '<button type="submit" class="act" name="same" value="no">The other way</button></div></div></form>'
    );
  }

  /** HTML of the forms for hobby servos: those that were added, one more, and writing the face's YAML. */
  wired(state) {
    const board = state.kinds[state.kind];
    const rows = state.wired
      .map((each) => `<li><b>${escaped(spoken(each.name))}</b> on channel ${each.channel}; a longer pulse ${escaped(each.positive)} <button type="button" class="act small" data-unwire="${escaped(each.name)}">Remove</button></li>`)
      .join("");
    return (
      "<p>Hobby servos cannot be asked who they are: say what is on which channel of the board.</p>" +
      `<ul class="wired">${rows}</ul><form data-form="wire" class="fields">` +
      '<label>Joint<input class="field" name="name" list="joint-names" placeholder="jaw" autocapitalize="off"></label>' +
      '<label>Channel<input class="field" name="channel" inputmode="numeric" placeholder="0"></label>' +
      `<label>A longer pulse<select class="field" name="positive">${WORDS.map((word) => `<option>${word}</option>`).join("")}</select></label>` +
      '<button class="act">Add</button></form>' +
      `<datalist id="joint-names">${NAMES.map((name) => `<option value="${name}">`).join("")}</datalist>` +
      `<form data-form="face" class="fields"><label>The board's ${escaped(board)}<input class="field" name="board" placeholder="the usual one"></label>` +
      `<button class="act first"${state.wired.length ? "" : " disabled"}>Write ${escaped(state.file.split("/").at(-1))}</button></form>`
    );
  }

  /** What the first move did, in the word that was chosen. */
  change() {
    const word = this.body.querySelector("[name=positive]")?.value;
    const did = this.body.querySelector(".did");
    if (did && word) did.textContent = DID[word] ?? `did that: ${word}`;
  }

  /** Do what the pressed button says; its `data-` attributes name a servo, a port or an action. */
  click(button) {
    if (button === null || button.type === "submit") return;
    const { id, do: what, unwire, port } = button.dataset;
    if (id) {
      this.id = id;
      this.update(this.hour.state);
    } else if (unwire) this.hour.post("wire", { channel: unwire });
    else if (port) this.hour.post("port", { port, ...this.kind() });
    else if (what === "move") this.hour.post("start", { step: "nudge", id: Number(this.id) });
    else if (what === "write") this.hour.post("face");
    else if (what === "clear") this.hour.post("start", { step: "find", clear: true });
    else if (what === "simulate") this.hour.post("port", { simulated: true });
  }

  kind() {
    const kind = this.body.querySelector("[name=kind]")?.value;
    return kind ? { kind } : {};
  }

  /** button: the one pressed; not what has the focus, which Safari gives no button. */
  async submit(form, button) {
    const value = (name) => form.elements[name]?.value.trim() ?? "";
    if (form.dataset.form === "port") {
      this.hour.post("port", value("port") ? { port: value("port"), ...this.kind() } : this.kind());
    } else if (form.dataset.form === "name") {
      const same = button?.value !== "no";
      const body = { id: Number(this.id), name: value("name"), positive: value("positive"), part: value("part"), same };
      if (!(await this.hour.post("name", body))) return;
      this.id = null; // the next one that has no name
      this.update(this.hour.state);
    } else if (form.dataset.form === "wire") {
      if (await this.hour.post("wire", { channel: `${value("name")}=${value("channel")}:${value("positive")}` })) form.reset();
    } else this.hour.post("face", value("board") ? { board: value("board") } : {});
  }
}

/** The ports that are there, any other, and a rehearsal. Pure. */
function ports(state) {
  const known = state.ports.length
    ? `<div class="buttons">${state.ports
        .map(({ port, what }) => `<button type="button" class="act port-choice" data-port="${escaped(port)}"><b>${escaped(port)}</b><small>${escaped(what)}</small></button>`)
        .join("")}</div>`
    : "<p>No USB adapter is plugged in. Plug it in, switch the servos' supply on, and it appears here.</p>";
  const kinds = Object.keys(KINDS).filter((kind) => kind in state.kinds);
  return (
    `<p>Where are the servos?</p>${known}` +
    '<form class="fields" data-form="port"><label>Another port<input class="field" name="port" placeholder="/dev/ttyUSB0" autocapitalize="off"></label>' +
    `<label>Kind of servos<select class="field" name="kind"><option value="">as the port says</option>${kinds
      .map((kind) => `<option value="${kind}">${KINDS[kind]}</option>`)
      .join("")}</select></label><button class="act">Find servos</button></form>` +
    '<p class="rehearse">No robot on the table? <button type="button" class="act" data-do="simulate">Rehearse with four simulated servos</button></p>'
  );
}

/** What another program has written into servos, and the question before it is taken back. Pure. */
function strangers(foreign) {
  const rows = Object.entries(foreign)
    .map(([id, changes]) => `<li>id ${id}: ${escaped(changes.join("; "))}</li>`)
    .join("");
  return (
    "<p>Another program has set these servos up. As they are they cannot be moved here.</p>" +
    `<ul>${rows}</ul><button type="button" class="act first" data-do="clear">Write what they should be</button>`
  );
}
