// How the face does in numbers and plain sentences: delay, late ticks, who listens, troubles.
import { face, facts, onDraw, onStatus } from "../link.js";
import { counted, escaped, isStopped, shown, spoken } from "../words.js";

const MOST_LINES = 4;

class FaceFacts extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<div class="phoneme"><b></b><span></span></div><p class="words"></p>' +
      '<div class="arousal"><span>calm</span><i><u></u></i><span>excited</span></div>' +
      '<dl></dl><ul class="troubles"></ul>';
    this.letters = this.querySelector(".phoneme b");
    this.saying = this.querySelector(".phoneme span");
    this.words = this.querySelector(".words");
    this.needle = this.querySelector(".arousal u");
    this.list = this.querySelector("dl");
    this.troubles = this.querySelector(".troubles");
    this.undo = [onDraw((frame) => this.draw(frame)), onStatus((status) => this.tell(status))];
  }

  disconnectedCallback() {
    this.undo.forEach((each) => each());
  }

  /** Show a frame's phoneme, arousal, and whether the face speaks. */
  draw(frame) {
    const name = frame.phoneme ?? "";
    const text = name === "SIL" ? "" : name;
    if (this.letters.textContent !== text) this.letters.textContent = text;
    const colours = facts.groupColours?.[facts.phonemeGroups?.[text]] ?? ["#eef2f5", "#15202b"];
    [this.letters.style.background, this.letters.style.color] = text ? colours : ["", ""];
    const place = Math.round(50 + 50 * Math.min(1, Math.max(-1, frame.arousal)));
    this.needle.style.left = `${place}%`;
    const says = face.phase === "stopped" ? "stopped" : frame.cutOff ? "cut off: mouth shut" : frame.speaking ? "speaking" : "silent";
    if (this.saying.textContent !== says) this.saying.textContent = says;
  }

  /** Show a status: words that are said, figures, troubles. */
  tell(status) {
    this.words.innerHTML = caption(status);
    this.list.innerHTML = rows(status)
      .map(([word, value]) => `<dt>${escaped(word)}</dt><dd>${escaped(value)}</dd>`)
      .join("");
    const all = troubleLines(status, face.phase === "gone" && face.lastState === "ended");
    const lines = all.slice(0, MOST_LINES);
    if (all.length > lines.length) lines.push(`And ${all.length - lines.length} more: see Servos.`);
    this.troubles.innerHTML = lines.map((line) => `<li>${escaped(line)}</li>`).join("");
    this.troubles.classList.toggle("none", lines.length === 0);
    if (!lines.length) this.troubles.innerHTML = "<li>No troubles.</li>";
  }
}

/** The status's words as HTML, the one that is said now in bold. status: may be null. Pure. */
export function caption(status) {
  const words = status?.words ?? [];
  return words
    .map((word, n) => {
      const gap = n === 0 || (isUnspaced(words[n - 1]) && isUnspaced(word)) ? "" : " ";
      return gap + (n === status.word ? `<b>${escaped(word)}</b>` : escaped(word));
    })
    .join("");
}

/** Whether a word is of a script that is written without spaces. Pure. */
function isUnspaced(word) {
  return /^[\p{Script=Han}\p{Script=Hiragana}\p{Script=Katakana}\p{Script=Thai}]/u.test(word);
}

const MOVED_BY = {
  sound: "what is heard",
  text: "its text, followed in the sound",
  words: "its words, followed in the sound",
  phonemes: "its phonemes",
  visemes: "its visemes",
};

/** [label, value] for each line of facts. Pure. */
export function rows(status) {
  if (status === null) return [["face", "does not answer"]];
  const lines = [];
  if (isStopped(status) && status.stopped_by) lines.push(["stopped by", status.stopped_by]);
  if (status.speaking) lines.push(["says", status.speaking]);
  else if (status.sound) lines.push(["hears", status.sound]);
  if (status.moved_by) lines.push(["mouth moved by", MOVED_BY[status.moved_by]]);
  if (status.delay_ms != null) lines.push(["mouth behind the sound", shown(status.delay_ms, 0, "ms")]);
  if (status.n_ticks != null) lines.push(["updates too late", lateWords(status.n_late, status.n_ticks)]);
  if (status.recognizer) lines.push(["recogniser", status.recognizer]);
  if (status.output) lines.push(["loudspeaker", status.output + (status.output_lost ? ": lost" : "")]);
  return lines;
}

/** `3 of 12,400`; a late tick is one that was skipped. Pure. */
export function lateWords(nLate, nTicks) {
  const late = nLate ?? 0;
  return `${late.toLocaleString("en")} of ${(late + (nTicks ?? 0)).toLocaleString("en")}`;
}

/** What is not as it should be, a sentence each. hasEnded: after a confirmed stop. Pure. */
export function troubleLines(status, hasEnded = false) {
  if (status === null) return [hasEnded ? "The face has ended." : "The face does not answer."];
  const lines = [...(status.troubles ?? [])];
  if (isStopped(status)) {
    for (const [name, why] of Object.entries(status.stop_report?.unconfirmed ?? {})) {
      lines.push(`${spoken(name)}: not confirmed to be limp (${why}).`);
    }
  }
  if (status.plugged === false) lines.unshift("The servos' port is gone: look at the plug.");
  if (status.output_lost) lines.push("The loudspeaker is gone; the mouth waits for it.");
  if (status.n_lost_sound_blocks > 0) {
    lines.push(`${counted(status.n_lost_sound_blocks, "block")} of sound of 10 ms not heard.`);
  }
  if (status.n_playout_underruns > 0) {
    lines.push(`Speech came too late ${counted(status.n_playout_underruns, "time")}.`);
  }
  return lines;
}

customElements.define("face-facts", FaceFacts);
