// A run on the plan: where car and road user are at a time, who sees whom when, and why it is lost.

import { bodyCorners, element, inWords, points, say, seconds, stretches, unpackBits, wedgeCorners } from "./shared.js";
import { tr, trn } from "./words.js";

const THIN = { "vector-effect": "non-scaling-stroke" };
const CAR_COLOUR = "#333", ROAD_USER_COLOUR = "#F0E442", SEES_COLOUR = "#000";
const ROW_PX = 18, PAD_PX = 9, MOST_ROWS = 30;

// ---------- on the plan

export function createRunDrawing({ ground, marks, at, put }) {
  let run = null, frame = 0, seeing = [];
  for (const layer of [ground, marks]) layer.setAttribute("pointer-events", "none");
  const still = element("g", {}, ground);
  const outlined = { stroke: "#000", "stroke-width": 1.2, ...THIN };
  const moving = element("g", { class: "played" }, ground);
  const car = element("polygon", { fill: CAR_COLOUR, class: "played-car", ...outlined }, moving);
  const wedge = element("polygon", { fill: "#fff", ...outlined }, moving);
  const user = element("polygon", { fill: ROAD_USER_COLOUR, class: "played-user", ...outlined }, moving);
  const lines = element("g", {}, marks);
  const last = element("path", { d: "M-7 -7L7 7M-7 7L7 -7", stroke: "#000", "stroke-width": 3 }, marks);
  element("title", { text: tr("centre of the car at the last moment to brake") }, last);
  const ring = element("circle", { r: 11, fill: "none", stroke: ROAD_USER_COLOUR, "stroke-width": 3 }, marks);
  const edge = element("circle", { r: 13, fill: "none", stroke: "#000", "stroke-width": 1.2 }, marks);

  function layOut() {
    for (const layer of [ground, marks]) layer.setAttribute("display", run ? "" : "none");
    if (run) show(frame, seeing);
  }

  // One frame; `seers` are the places of those who see the road user in it.
  function show(next, seers) {
    [frame, seeing] = [next, seers];
    const place = [run.road.x[frame], run.road.y[frame]];
    const corners = bodyCorners(run.car, run.carSize, frame);
    car.setAttribute("points", points(corners));
    wedge.setAttribute("points", points(wedgeCorners(corners)));
    user.setAttribute("points", points(bodyCorners(run.road, run.roadSize, frame)));
    for (const mark of [ring, edge]) put(mark, place);
    last.setAttribute("display", run.lastPlace ? "" : "none");
    if (run.lastPlace) put(last, run.lastPlace);
    lines.replaceChildren();
    const [x2, y2] = at(place);
    seers.forEach((seer) => {
      const [x1, y1] = at(seer);
      element("line", { x1, y1, x2, y2, class: "sees", stroke: SEES_COLOUR, "stroke-width": 1.8 }, lines);
    });
  }

  return {
    layOut,
    showFrame: show,
    showRun(next) {
      run = next;
      still.replaceChildren();
      if (run) {
        const way = (motion) => "M" + motion.x.map((x, index) => `${x} ${motion.y[index]}`).join("L");
        element("path", { d: way(run.car), fill: "none", stroke: CAR_COLOUR, "stroke-width": 2, ...THIN }, still);
        element("path", { d: way(run.road), fill: "none", stroke: "#000", "stroke-width": 1.8, "stroke-dasharray": "4 3", ...THIN }, still);
        run.parked.forEach((body) => {
          const box = element("polygon", { points: points(body.corners), fill: "url(#parked-fill)", stroke: "#666", ...THIN }, still);
          element("title", { text: tr("parked: {name}", { name: say(body.name) }) }, box);
        });
        [frame, seeing] = [0, []];
      }
      layOut();
    },
  };
}

// ---------- in words

// Bits of every party, and a word on each that is a unit or the car.
export function partiesOf(message) {
  const { record, parties } = message;
  const rows = unpackBits(record.bits, parties.length, record.time.length);
  return parties.map((party, index) => ({
    ...party, name: party.kind === "vut" ? tr("the car") : party.name, detected: rows[index], confirmed: record.confirmed[index], onset: record.onset[index], isAvoided: record.avoided[index],
  }));
}

const late = (party, record) => (party.onset === null || record.last === null ? null : party.onset - record.last);

function countOf(party) {
  return party.detected.reduce((sum, bit) => sum + bit, 0);
}

// What one party does in a run.
export function sayParty(party, record, who = party.name) {
  const lateMs = late(party, record), seen = {
    who, n: countOf(party), all: record.time.length, when: inWords(party.detected, record.time),
    confirmed: seconds(party.confirmed), late: seconds(lateMs),
  };
  if (!seen.n) return tr("{who} never sees the road user", seen);
  if (party.confirmed === null) return tr("{who} sees the road user in {n} of {all} frames ({when} s), never often enough in a row to confirm it", seen);
  if (party.isAvoided) return tr("{who} sees the road user in {n} of {all} frames ({when} s), confirms it at {confirmed} s, in time", seen);
  if (lateMs === null) return tr("{who} sees the road user in {n} of {all} frames ({when} s), confirms it at {confirmed} s, and loses it again before the last moment", seen);
  return tr("{who} sees the road user in {n} of {all} frames ({when} s), confirms it at {confirmed} s, {late} s too late", seen);
}

// Why a run is lost, in a sentence, by the unit that came nearest: least late, or most often seeing.
export function sayWhy(message, isLost, idOf) {
  const { record, units: explained, inTime } = message;
  const units = partiesOf(message).filter((party) => party.kind === "unit");
  if (!isLost) {
    const first = units.filter((party) => party.isAvoided).sort((a, b) => a.confirmed - b.confirmed)[0];
    return first ? tr("Avoided now: {what}.", { what: sayParty(first, record) }) : tr("Avoided now.");
  }
  if (!inTime) return tr("Lost with any layout: no frame comes early enough to brake.");
  const reasonsOf = (party) => explained.find((one) => one.unit === idOf(party.name))?.reasons ?? [];
  const rank = (party) => {
    if (!countOf(party)) return 1e7 + (reasonsOf(party).find((why) => why.cause === "out of view")?.frames ?? 0); // it looks elsewhere
    const lateMs = late(party, record);
    return party.confirmed !== null && lateMs !== null && lateMs > 0 ? lateMs : party.confirmed !== null ? 1e6 : 1e7 - countOf(party);
  };
  const nearest = [...units].sort((a, b) => rank(a) - rank(b))[0];
  const reasons = reasonsOf(nearest).map((why) => `${why.frames} (${why.words})`).join(", ");
  const missed = { n: inTime, unit: nearest.name, reasons };
  if (!countOf(nearest)) return reasons ? tr("No unit sees the road user: of the {n} frames that come in time, {unit} misses {reasons}.", missed) : tr("No unit sees the road user.");
  const said = [tr("{unit} comes nearest: {what}.", { unit: nearest.name, what: sayParty(nearest, record, tr("it")) })];
  if (reasons) said.push(tr("Of the {n} frames that come in time, it misses {reasons}.", missed));
  return said.join(" ");
}

// ---------- the strip below the plan

const find = (id) => document.getElementById(id);

export function createPlayed({ map, unitsNow, onClose, onWhy, onFrame }) {
  let message = null, shown = [], timer = 0, markers = [], widthPx = 0;
  const slider = find("played-frame");

  function show(next, { title, isLost }) {
    const isSame = message?.run === next.run;
    message = next;
    shown = partiesOf(message).filter((party) => party.kind === "unit" || party.kind === "vut").slice(0, MOST_ROWS);
    const { record } = message;
    find("played").hidden = false;
    find("played-title").textContent = title;
    find("played-sentence").textContent = sayWhy(message, isLost, (name) => unitsNow().find((unit) => unit.name === name)?.id);
    find("played-sentence").classList.remove("old");
    slider.max = record.time.length - 1;
    if (!isSame) slider.value = record.last === null ? slider.max : record.time.filter((ms) => ms <= record.last).length - 1;
    map.run.showRun(record);
    drawRows();
    showFrame();
  }

  function drawRows() {
    const holder = find("played-rows"), { record } = message;
    holder.replaceChildren();
    widthPx = Math.max(holder.clientWidth, 200);
    const nameCharacters = Math.max(...shown.map((party) => party.name.length), 3);
    const left = Math.min(8 + 7.2 * nameCharacters, 90), n = record.time.length;
    const x = (frame) => left + PAD_PX + (widthPx - left - 2 * PAD_PX) * frame / Math.max(n - 1, 1);
    slider.parentElement.style.setProperty("--left", `${left}px`);
    const half = (x(1) - x(0)) / 2, frameOf = (ms) => (ms - record.time[0]) / (record.time[n - 1] - record.time[0]) * (n - 1);
    markers = [];
    shown.forEach((party) => {
      const row = element("svg", { width: widthPx, height: ROW_PX, role: "img", "aria-label": sayParty(party, record) }, holder);
      element("title", { text: sayParty(party, record) }, row);
      element("text", { text: party.name, x: 0, y: 13, "font-size": 12 }, row);
      element("rect", { x: x(0) - half, y: 3, width: x(n - 1) - x(0) + 2 * half, height: ROW_PX - 6, fill: "#f1f1f1" }, row);
      stretches(party.detected).forEach(([first, end]) => element("rect", { x: x(first) - half, y: 3, width: x(end) - x(first) + 2 * half, height: ROW_PX - 6, fill: party.kind === "vut" ? CAR_COLOUR : unitsNow().find((unit) => unit.name === party.name)?.colour ?? "#555" }, row));
      if (record.last !== null) element("path", { d: `M${x(frameOf(record.last))} 0V${ROW_PX}`, stroke: "#000", "stroke-width": 1.5, "stroke-dasharray": "3 2" }, row);
      if (party.confirmed !== null) element("path", { d: `M${x(frameOf(party.confirmed))} 3l6 6l-6 6l-6 -6Z`, fill: "#fff", stroke: "#000", "stroke-width": 1.4 }, row);
      markers.push(element("path", { stroke: "#000", "stroke-width": 2 }, row));
    });
    markers.place = (frame) => markers.forEach((marker) => marker.setAttribute("d", `M${x(frame)} 0V${ROW_PX}`));
  }

  function showFrame() {
    const frame = slider.valueAsNumber, { record } = message;
    const seeing = shown.filter((party) => party.detected[frame]);
    const places = seeing.map((party) => (party.kind === "vut" ? [record.car.x[frame], record.car.y[frame]] : unitsNow().find((unit) => unit.name === party.name)?.place)).filter(Boolean);
    map.run.showFrame(frame, places);
    markers.place(frame);
    onFrame();
    const ms = record.time[frame];
    const isOver = record.last !== null && ms > record.last;
    const names = seeing.map((party) => party.name).join(", "), time = seconds(ms, 1);
    const what = names ? trn("{names} sees the road user", "{names} see the road user", seeing.length, { names }) : tr("nobody sees the road user");
    find("played-time").textContent = isOver ? tr("{time} s, too late to brake: {what}", { time, what }) : tr("{time} s: {what}", { time, what });
    slider.setAttribute("aria-valuetext", find("played-time").textContent);
  }

  function stop() {
    clearInterval(timer);
    timer = 0;
    find("played-play").textContent = tr("Play");
  }

  function close() {
    if (!message) return false;
    stop();
    message = null;
    find("played").hidden = true;
    map.run.showRun(null);
    onClose();
    return true;
  }

  slider.addEventListener("input", () => { stop(); showFrame(); });
  find("played-play").addEventListener("click", () => {
    if (timer) { stop(); return; }
    const { time } = message.record, last = Number(slider.max);
    if (slider.valueAsNumber >= last) slider.value = 0;
    find("played-play").textContent = tr("Pause");
    showFrame();
    timer = setInterval(() => {
      slider.value = slider.valueAsNumber + 1;
      showFrame();
      if (slider.valueAsNumber >= last) stop();
    }, time.length > 1 ? (time.at(-1) - time[0]) / last : 100);
  });
  find("played-close").addEventListener("click", close);
  find("played-why").addEventListener("click", () => onWhy());
  new ResizeObserver(() => { if (message && find("played-rows").clientWidth !== widthPx) { drawRows(); showFrame(); } }).observe(find("played-rows"));

  return {
    show, close,
    run: () => message?.run,
    frame: () => slider.valueAsNumber,
    old() { if (message) find("played-sentence").classList.add("old"); },
  };
}
