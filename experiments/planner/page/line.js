// The connection to the session: messages both ways, and how to reconnect.

import { bytes, tr } from "./words.js";

const FIRST_WAIT_MS = 400, LONGEST_WAIT_MS = 5000, PATIENCE_MS = 1500, SILENCE_MS = 3000;

export function openLine({ onMessage, onState, onSilence }) {
  let socket = null, wait = FIRST_WAIT_MS, sentAt = 0, waiting = null;
  let nSent = 0, unanswered = 0, isSilent = false; // since when what was sent is not answered
  const address = new URL("live", location.href);
  address.protocol = "ws:";

  function connect() {
    socket = new WebSocket(address);
    socket.addEventListener("open", () => { wait = FIRST_WAIT_MS; sentAt = 0; waiting = null; heard(); nSent = 0; onState(true); });
    socket.addEventListener("message", (event) => {
      const message = JSON.parse(event.data);
      if (message.type === "state" || message.type === "problem") flush();
      if (message.type === "heard") heard(message.number < nSent);
      onMessage(message);
    });
    socket.addEventListener("close", () => {
      heard();
      onState(false);
      setTimeout(connect, wait);
      wait = Math.min(2 * wait, LONGEST_WAIT_MS);
    });
  }

  function heard(isMoreSent = false) {
    unanswered = isMoreSent ? performance.now() : 0;
    if (isSilent) onSilence(0);
    isSilent = false;
  }
  setInterval(() => {
    const silent = unanswered ? performance.now() - unanswered : 0;
    if (silent < SILENCE_MS) return;
    isSilent = true;
    onSilence(silent / 1000);
  }, 500);

  // Of a gesture's steps only the newest waits: the next one goes when the last was answered.
  function flush() {
    sentAt = 0;
    if (waiting) { const next = waiting; waiting = null; put(next, true); }
  }

  function put(message, isStep) {
    if (socket.readyState !== WebSocket.OPEN) return;
    if (isStep) sentAt = performance.now();
    nSent += 1;
    unanswered ||= performance.now();
    socket.send(JSON.stringify(message));
  }

  connect();
  return {
    send(message) { flush(); put(message, false); },
    isAsking: () => Boolean(sentAt || waiting),
    step(message) {
      if (waiting && waiting.unit !== message.unit) flush(); // another unit's newest step is none of this one's
      if (sentAt && performance.now() - sentAt < PATIENCE_MS) waiting = message;
      else put(message, true);
    },
  };
}

async function answerOf(response) {
  const kind = response.headers.get("content-type") || "";
  if (response.ok) return kind.startsWith("application/json") ? response.json() : response.blob();
  const said = kind.startsWith("application/json") ? (await response.json()).problem : tr("it answers {status}", response);
  throw Object.assign(new Error(said), { status: response.status });
}

export const ask = async (path, values = {}) => answerOf(await fetch(`${path}?${new URLSearchParams(values)}`));

// What is too large is not sent: browsers do not read an answer that comes before all is sent.
export async function give(path, body, { headers = {}, most = Infinity } = {}) {
  if (body.size > most) throw new Error(tr("{file}: got {size} bytes; expected at most {most}", { file: body.name || tr("file"), size: bytes(body.size), most: bytes(most) }));
  return answerOf(await fetch(path, { method: "POST", body, headers }));
}
