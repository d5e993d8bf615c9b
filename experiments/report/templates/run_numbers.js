// Numbers of a run: bits, times in words, elements.

const MINUS = "\u2212";

function element(tag, attributes, parent) {
  const isDrawn = ["svg", "g", "path", "rect", "line", "circle", "text", "title", "polygon", "pattern", "defs", "image"].includes(tag);
  const made = isDrawn ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name === "text") made.textContent = value;
    else made.setAttribute(name, value);
  }
  if (parent) parent.append(made);
  return made;
}

// Rows of bits, each padded to whole bytes, the first bit highest.
function unpackBits(text, nRows, n) {
  const bytes = atob(text);
  const stride = Math.ceil(n / 8);
  return Array.from({ length: nRows }, (_, row) =>
    Array.from({ length: n }, (_, bit) =>
      (bytes.charCodeAt(row * stride + (bit >> 3)) >> (7 - (bit & 7))) & 1));
}

function seconds(ms, decimals = 2) {
  const text = (Math.abs(ms) / 1000).toFixed(decimals);
  return (ms < 0 && Number(text) !== 0 ? MINUS : "") + (hasCommas ? text.replace(".", ",") : text);
}

// First and last frame of each stretch in which a row has ones.
function stretches(row) {
  const found = [];
  row.forEach((bit, frame) => {
    if (!bit) return;
    if (frame > 0 && row[frame - 1]) found[found.length - 1][1] = frame;
    else found.push([frame, frame]);
  });
  return found;
}

function inWords(row, time) {
  const parts = stretches(row).map(([first, last]) =>
    first === last ? seconds(time[first]) : say("{first} to {last}", { first: seconds(time[first]), last: seconds(time[last]) }));
  return parts.join(hasCommas ? "; " : ", ") || say("never");
}

function outcome(run, party) {
  if (run.avoided[party]) return say("avoided");
  if (run.confirmed[party] === null) return run.detected[party].includes(1) ? say("never confirmed") : say("never seen");
  return run.onset[party] === null ? say("lost again") : say("too late");
}

// The last frame in which braking still helps; the first one where none does.
function lastFrame(run) {
  let frame = 0;
  if (run.last !== null) run.time.forEach((ms, index) => { if (ms <= run.last) frame = index; });
  return frame;
}

// How far along the run a time is, 0 .. 1; null outside of it.
function shareOf(run, ms) {
  if (ms === null || run.time.length < 2) return null;
  const share = (ms - run.time[0]) / (run.time[run.time.length - 1] - run.time[0]);
  return share < 0 || share > 1 ? null : share;
}
