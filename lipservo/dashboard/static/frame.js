// The stream of a face: what a frame of /api/twin means, and a connection that keeps the newest.
// lipservo/dashboard/live_frames.py writes what is read here.

const UNKNOWN = 255;
const ABSENT = -32768;
const TORQUE_ON = 1, SERVOS_GONE = 2, SPEECH_GONE = 4, CUT_OFF = 8, SPEAKING = 16;
// A connection that brings nothing for so long counts as dead, whatever the browser says of it.
const SILENT_MS = 3000;
const FIRST_RETRY_MS = 250, LONGEST_RETRY_MS = 4000;

// The values of one binary frame of /api/twin; live_frames.py has its layout. hello: the stream's first
// message, with the names that indices refer to. state, phoneme: names, null where unknown.
export function decode(buffer, hello) {
  const view = new DataView(buffer);
  const name = (names, index) => (index === UNKNOWN ? null : names[index] ?? null);
  const flags = view.getUint8(10);
  let offset = 12;
  const coefficients = new Float32Array(hello.n_components);
  for (let i = 0; i < hello.n_components; i++, offset += 4) coefficients[i] = view.getFloat32(offset, true);
  const expression = {};
  for (const each of hello.expression) {
    const raw = view.getInt16(offset, true);
    expression[each] = raw === ABSENT ? null : raw / (each.endsWith("_deg") ? 100 : 10000);
    offset += 2;
  }
  const angles = () => hello.servos.map(() => {
    const raw = view.getInt16(offset, true);
    offset += 2;
    return raw === ABSENT ? null : raw / 100;
  });
  const goalsDeg = angles(), encodersDeg = angles();
  const nPeaks = view.getUint8(offset);
  const peaks = Array.from(new Uint8Array(buffer, offset + 1, nPeaks), (peak) => peak / 255);
  return {
    n: view.getUint32(0, true),
    timeS: view.getFloat32(4, true),
    state: name(hello.states, view.getUint8(8)),
    phoneme: name(hello.phonemes, view.getUint8(9)),
    torqueOn: (flags & TORQUE_ON) !== 0,
    servosGone: (flags & SERVOS_GONE) !== 0,
    speechGone: (flags & SPEECH_GONE) !== 0,
    cutOff: (flags & CUT_OFF) !== 0,
    speaking: (flags & SPEAKING) !== 0,
    arousal: view.getInt8(11) / 127,
    coefficients, expression, goalsDeg, encodersDeg, peaks,
  };
}

// Call onHello(hello) for each connection, onFrame(frame) at most once a picture with the newest frame,
// and onLost() when the dashboard is gone; it is connected to again for ever. onEvery(frame), where
// given, gets every frame, for listeners that must miss none. Returns a function that disconnects.
export function connect(onFrame, onHello, onLost, onEvery = null) {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  let socket = null, hello = null, newest = null, scheduled = false;
  let over = false, retryMs = FIRST_RETRY_MS, lost = false, watchdog = null;

  const show = () => {
    scheduled = false;
    if (newest === null || over) return;
    const frame = newest instanceof ArrayBuffer ? decode(newest, hello) : newest;
    newest = null;
    onFrame(frame);
  };
  const lose = () => {
    clearTimeout(watchdog);
    const dead = socket;
    socket = null;
    if (dead !== null) {
      dead.onclose = dead.onmessage = dead.onerror = null;
      dead.close();
    }
    if (over) return;
    if (!lost) onLost();
    lost = true;
    setTimeout(open, retryMs);
    retryMs = Math.min(2 * retryMs, LONGEST_RETRY_MS);
  };
  const guard = () => {
    clearTimeout(watchdog);
    watchdog = setTimeout(lose, SILENT_MS);
  };
  const hear = (event) => {
    guard();
    retryMs = FIRST_RETRY_MS;
    lost = false;
    if (typeof event.data === "string") {
      hello = JSON.parse(event.data);
      newest = null;
      onHello(hello);
      return;
    }
    if (hello === null) return;
    newest = event.data;
    if (onEvery !== null) onEvery(newest = decode(event.data, hello));
    // In a tab that is not seen the browser asks for no picture: onFrame is not called.
    if (!scheduled) {
      scheduled = true;
      requestAnimationFrame(show);
    }
  };
  const open = () => {
    if (over) return;
    socket = new WebSocket(`${scheme}://${location.host}/api/twin`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = hear;
    socket.onclose = socket.onerror = lose;
    guard();
  };
  open();
  return () => {
    over = true;
    lose();
  };
}

// The frames of the last 30 s, oldest first, for a page just opened. hello: the stream's first message.
export async function history(hello) {
  const answer = await fetch("/api/history");
  if (!answer.ok) return [];
  const buffer = await answer.arrayBuffer();
  const view = new DataView(buffer), frames = [];
  for (let at = 0; at < buffer.byteLength;) {
    const length = view.getUint16(at, true);
    frames.push(decode(buffer.slice(at + 2, at + 2 + length), hello));
    at += 2 + length;
  }
  return frames;
}
