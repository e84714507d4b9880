// Calls of the API. What comes back is JSON, or an Error whose message is a sentence for people;
// its `status` is that of the answer, undefined where none came.
import { LOCKED } from "./stop.js";

const PATIENCE_MS = 5000;

/** The answer to GET. */
export function getJson(path, patienceMs = PATIENCE_MS) {
  return call("GET", path, undefined, patienceMs);
}

/** The answer to POST of a JSON body. keepalive: the call outlives the page. */
export function postJson(path, body = {}, { patienceMs = PATIENCE_MS, keepalive = false } = {}) {
  return call("POST", path, body, patienceMs, keepalive);
}

/** The answer to PATCH of a JSON body. */
export function patchJson(path, body) {
  return call("PATCH", path, body, PATIENCE_MS);
}

/** The answer to DELETE. */
export function remove(path) {
  return call("DELETE", path, undefined, PATIENCE_MS);
}

/**
 * The parsed answer to a request. Throws an Error with a sentence for people, and with the HTTP
 * `status` if an answer came. patienceMs: how long to wait for one.
 */
async function call(method, path, body, patienceMs, keepalive = false) {
  const request = { method, cache: "no-store", keepalive, signal: AbortSignal.timeout(patienceMs) };
  if (body !== undefined) {
    request.headers = { "Content-Type": "application/json" };
    request.body = JSON.stringify(body);
  }
  let response;
  try {
    response = await fetch(path, request);
  } catch {
    throw new Error("The dashboard does not answer.");
  }
  const text = await response.text();
  const answer = parsed(text);
  if (!response.ok) throw refusal(response.status, answer);
  return answer;
}

/** An answer that is no success, as an Error. Pure. */
export function refusal(status, answer) {
  const text = status === 401 ? LOCKED : (sentence(answer) ?? `It was refused (${status}).`);
  return Object.assign(new Error(text), { status });
}

/** The error message of an answer, in whichever form it came; null: it has none. Pure. */
export function sentence(answer) {
  if (typeof answer === "string") return answer || null;
  const error = answer?.error ?? answer?.detail ?? answer?.message;
  if (typeof error === "string") return error;
  if (Array.isArray(error) && error[0]?.msg) {
    return error.map((each) => `${each.loc?.at(-1) ?? ""}: ${each.msg}`).join("; ");
  }
  return null;
}

/** An answer's JSON; text that is none as it is if it is short, else null. */
function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return text.length < 200 ? text : null;
  }
}
