// The page of a rater. An answer is kept in the browser until the server has confirmed it, so that
// neither a page that is closed nor a server that is gone loses one; sent again, it counts once.
const RETRY_MS = 2000;
const PATIENCE_MS = 10000;
const main = document.querySelector("main");
const trouble = document.querySelector("#trouble");
let study, rater;

/** A stored text of this study; undefined as value removes it. */
const store = {
  key: (name) => `${study.identity}/${name}`,
  get: (name) => localStorage.getItem(store.key(name)),
  set: (name, value) => localStorage.setItem(store.key(name), value),
  remove: (name) => localStorage.removeItem(store.key(name)),
};

/** An element with attributes, listeners (`onclick`) and children. */
function make(tag, attributes = {}, ...children) {
  const element = Object.assign(document.createElement(tag), attributes);
  element.append(...children);
  return element;
}

async function call(method, path, body) {
  const request = { method, cache: "no-store", signal: AbortSignal.timeout(PATIENCE_MS) };
  if (body !== undefined) {
    request.headers = { "Content-Type": "application/json" };
    request.body = JSON.stringify(body);
  }
  let response, answer;
  try {
    response = await fetch(path, request);
    answer = await response.json();
  } catch {
    throw Object.assign(new Error("The study does not answer. Your answers are safe; please wait."), { again: true });
  }
  if (response.ok) return answer;
  throw Object.assign(new Error(answer.error), { again: response.status >= 500, status: response.status });
}

/** Calls until it is answered; what cannot be mended by waiting is thrown. */
async function insist(method, path, body) {
  for (;;) {
    try {
      const answer = await call(method, path, body);
      trouble.hidden = true;
      return answer;
    } catch (error) {
      trouble.textContent = error.message;
      trouble.hidden = false;
      if (!error.again) throw error;
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }
}

async function begin() {
  study = await insist("GET", "/api/study");
  document.title = document.querySelector("#title").textContent = study.title;
  rater = store.get("rater");
  if (!rater || store.get("joined") === null) return welcome();
  const pending = store.get("pending");
  try {
    if (pending) return await send(JSON.parse(pending));
    show(await insist("GET", `/api/raters/${rater}`));
  } catch (error) {
    // The server has never seen this rater: a study that was begun anew.
    if (error.status !== 404) throw error;
    forget();
    welcome();
  }
}

function forget() {
  for (const name of ["rater", "joined", "pending"]) store.remove(name);
  rater = null;
}

function welcome() {
  progress(null);
  const start = make("button", { className: "main", id: "start", disabled: true, onclick: join }, "Start");
  const agree = make("input", { type: "checkbox", id: "agree", onchange: () => (start.disabled = !agree.checked) });
  main.replaceChildren(
    make("h1", {}, "Before you begin"),
    make("div", { className: "consent" }, ...study.consent.split(/\n\s*\n/).map((text) => make("p", {}, text))),
    make("label", { className: "agree" }, agree, make("span", {}, "I am 18 or older, I have read this, and I take part of my own will.")),
    start,
  );
}

async function join() {
  this.disabled = true;
  // Chosen here, so that a call that is repeated makes no second rater.
  rater = store.get("rater") ?? Array.from(crypto.getRandomValues(new Uint8Array(6)), (b) => b.toString(16).padStart(2, "0")).join("");
  store.set("rater", rater);
  const first = await insist("POST", "/api/raters", { rater, agrees: true });
  store.set("joined", "");
  show(first);
}

async function send(answer) {
  store.set("pending", JSON.stringify(answer));
  for (const button of main.querySelectorAll("button")) button.disabled = true;
  let next;
  try {
    next = await insist("POST", `/api/raters/${rater}/answers`, answer);
  } catch (error) {
    // Answered before, on another device: what comes next is known all the same.
    if (error.status !== 409) throw error;
    next = await insist("GET", `/api/raters/${rater}`);
  }
  store.remove("pending");
  show(next);
}

function progress(item) {
  const bar = document.querySelector("#done");
  bar.hidden = item === null;
  document.querySelector("#count").textContent = item === null ? "" : `${item.number + 1} of ${item.of}`;
  if (item !== null) [bar.max, bar.value] = [item.of, item.number];
}

function show(item) {
  if (item.number === null) return finish();
  progress(item);
  main.replaceChildren(...SCREENS[item.kind](item));
  main.dataset.kind = item.kind;
  main.dataset.number = item.number;
  window.scrollTo(0, 0);
}

/** Sends what is chosen with how long it took since the item was shown, and how often it played. */
function answering(item, clips) {
  const began = performance.now();
  return (answer) =>
    send({
      number: item.number,
      answer,
      seconds: Math.round(performance.now() - began) / 1000,
      plays: clips.reduce((sum, clip) => sum + clip.plays(), 0),
    });
}

/** A clip that plays at a click. whenSeen: called each time that it was seen to its end. */
function clipOf(name, { silent = false, whenSeen }) {
  let plays = 0;
  const video = make("video", { src: `/clips/${name}.mp4`, playsInline: true, preload: "auto", muted: silent, disablePictureInPicture: true, disableRemotePlayback: true });
  const button = make("button", { type: "button", onclick: play }, "▶ Play");
  video.onended = () => {
    plays += 1;
    label("↻ Play again");
    whenSeen();
  };
  video.onerror = () => {
    label("↻ Try again");
    trouble.textContent = "This clip cannot be shown. Please tell the person who runs the study.";
    trouble.hidden = false;
  };
  function label(text) {
    button.textContent = text;
    button.hidden = false;
  }
  async function play() {
    for (const other of document.querySelectorAll("video")) other.pause();
    trouble.hidden = true;
    if (video.error) video.load();
    button.hidden = true;
    video.currentTime = 0;
    // A play that another clip interrupted is none.
    await video.play().catch(() => label("▶ Play"));
  }
  video.onpause = () => video.ended || label("▶ Play");
  return { element: make("div", { className: "clip" }, video, button), plays: () => plays, play };
}

function scaleOf(answer, enabled) {
  const buttons = study.scale.map((text, i) =>
    make("button", { type: "button", disabled: !enabled, onclick: () => answer(i + 1) }, make("b", {}, `${i + 1}`), text));
  return make("div", { className: "scale", role: "group" }, ...buttons);
}

const enable = (element) => element.querySelectorAll("button").forEach((each) => (each.disabled = false));

const SCREENS = {
  rating(item) {
    const hint = make("p", { className: "hint" }, "Watch the clip to its end first.");
    const clip = clipOf(item.clips[0], {
      whenSeen() {
        enable(scale);
        hint.textContent = "";
      },
    });
    const scale = scaleOf(answering(item, [clip]), false);
    return [
      make("h1", {}, "How natural is the movement of the mouth?"),
      make("p", {}, "Judge the mouth together with its sound, not the drawing of the head."),
      make("div", { className: "one" }, clip.element), scale, hint,
    ];
  },

  check(item) {
    return [
      make("h1", {}, `Please choose ${item.expected}.`),
      make("p", {}, "No clip this time: this only shows that somebody is reading."),
      scaleOf(answering(item, []), true),
    ];
  },

  pair(item) {
    const seen = new Set();
    const hint = make("p", { className: "hint" }, "Watch both to their ends first.");
    const choices = [];
    const clips = item.clips.map((name, i) => clipOf(name, {
      whenSeen() {
        seen.add(i);
        if (seen.size < 2) return;
        choices.forEach((each) => (each.disabled = false));
        hint.textContent = "";
      },
    }));
    const answer = answering(item, clips);
    const figures = clips.map((clip, i) => {
      const name = "AB"[i];
      choices[i] = make("button", { type: "button", disabled: true, onclick: () => answer(name) }, `${name} is more natural`);
      return make("figure", {}, make("figcaption", {}, name), clip.element, choices[i]);
    });
    return [
      make("h1", {}, "Which mouth moves more naturally?"),
      make("p", {}, "Both say the same. If you cannot tell, follow your first impression."),
      make("div", { className: "two" }, ...figures), hint,
    ];
  },

  reading(item) {
    const text = make("textarea", { rows: 2, maxLength: 500, placeholder: "What is said", disabled: true, autocapitalize: "off", autocomplete: "off", spellcheck: false });
    const done = make("button", { type: "button", className: "main", disabled: true, onclick: () => answer(text.value.trim()) }, "Next");
    const none = make("button", { type: "button", disabled: true, onclick: () => answer("") }, "I could read nothing");
    text.oninput = () => (done.disabled = !text.value.trim());
    const clip = clipOf(item.clips[0], {
      silent: true,
      whenSeen() {
        text.disabled = none.disabled = false;
        text.focus({ preventScroll: true });
      },
    });
    const answer = answering(item, [clip]);
    const places = study.vocabulary.map((words) => make("li", {}, words.join(" · ")));
    const help = places.length ? [make("ul", { className: "words" }, make("li", {}, make("b", {}, "A sentence has one word of each line:")), ...places)] : [];
    return [
      make("h1", {}, "Without sound: write what you read"),
      make("p", {}, "Play it as often as you like. Guess; a few words are better than none."),
      make("div", { className: "one" }, clip.element), text, make("div", { className: "row" }, done, none), ...help,
    ];
  },

  sound(item) {
    const scale = make("div", { className: "row" });
    const hint = make("p", { className: "hint" });
    let tries = 0;
    const answer = answering(item, [{ plays: () => tries }]);
    for (const n of [1, 2, 3, 4, 5, 6]) {
      scale.append(make("button", { type: "button", disabled: true, onclick: () => {
        if (n === item.expected) return answer(n);
        hint.textContent = "That was not the number. Turn the sound up and play it again.";
      } }, `${n}`));
    }
    const play = make("button", { type: "button", className: "main", id: "beeps", onclick() {
      tries += 1;
      beep(item.expected);
      enable(scale);
    } }, "▶ Play the beeps");
    return [
      make("h1", {}, "From here on with sound"),
      make("p", {}, "Put headphones on or turn the loudspeaker up. How many beeps do you hear?"),
      play, scale, hint,
    ];
  },
};

/** So many short tones, without a click at their ends. */
function beep(count) {
  const audio = new AudioContext();
  for (let n = 0; n < count; n += 1) {
    const [tone, level, start] = [audio.createOscillator(), audio.createGain(), audio.currentTime + 0.2 + 0.5 * n];
    tone.frequency.value = 660;
    level.gain.setValueAtTime(0, start);
    level.gain.linearRampToValueAtTime(0.25, start + 0.02);
    level.gain.setValueAtTime(0.25, start + 0.18);
    level.gain.linearRampToValueAtTime(0, start + 0.2);
    tone.connect(level).connect(audio.destination);
    tone.start(start);
    tone.stop(start + 0.2);
  }
}

function finish() {
  progress(null);
  main.dataset.kind = "end";
  const back = make("button", { type: "button", id: "leave", async onclick() {
    if (!window.confirm("Take all your answers back? They will not count.")) return;
    await insist("POST", `/api/raters/${rater}/leave`, {});
    said.textContent = "Your answers will not count. Thank you all the same.";
    back.disabled = true;
  } }, "Take my answers back");
  const said = make("p", {}, "All your answers are kept. You can close this page.");
  main.replaceChildren(
    make("h1", {}, "Thank you"),
    said,
    make("p", {}, "Your number is ", make("code", {}, rater), ". With it the person who runs the study finds your answers."),
    make("div", { className: "row" },
      make("button", { type: "button", className: "main", id: "next", onclick() {
        forget();
        welcome();
      } }, "Next person"), back),
  );
}

document.addEventListener("keydown", (event) => {
  if (event.target.tagName === "TEXTAREA" || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
  const scale = main.querySelector(".scale");
  if (scale && /^[1-5]$/.test(event.key)) scale.children[Number(event.key) - 1].click();
});

begin();
