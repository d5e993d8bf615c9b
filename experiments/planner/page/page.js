// The planner's page: shows the messages of the session, and sends it what is done here.

import { openDialogs } from "./dialogs.js";
import { ask, openLine } from "./line.js";
import { bandColour, createMap } from "./map.js";
import { element } from "./shared.js";

const find = (id) => document.getElementById(id);
const PATIENCE_MS = 120; // after a change, before the old number gives way to "computing"
const MOST_LOST = 150;
const FIELDS = {
  yaw: { name: "yaw_deg", of: (unit) => unit.yawDeg, digits: 1 },
  pitch: { name: "pitch_deg", of: (unit) => unit.pitchDeg, digits: 1 },
  height: { name: "height_m", of: (unit) => unit.heightM, digits: 2 },
  fov: { name: "fov_deg", of: (unit) => unit.fovDeg, digits: 1 },
};

let scene = null, state = null, numbers = null, proposals = [], selected = null, offered = null;
let isConnected = false, timer = 0, coverage = null, savedRevision = 0;

const line = openLine({ onMessage: read, onState: connected, onSilence: silent });
const map = createMap(find("plan"), {
  site: chooseSite,
  unit: chooseUnit,
  aim: (unit, aim, gesture) => put({ do: "change", unit, yaw_deg: aim.yaw, ...(aim.pitch === undefined ? {} : { pitch_deg: Math.max(-90, aim.pitch) }), gesture }),
  move: (unit, site) => line.send({ do: "change", unit, site }),
  hang: (site, aim) => hang(site, aim),
  giveUp: (gesture) => line.send({ do: "revert", gesture }),
  heightOf: (site) => Math.min(Math.max(8, site.low), site.high),
});
const dialogs = openDialogs({ map, notice, scene: () => scene, state: () => state, saved: () => { savedRevision = state.revision; } });

// A plan that is in no file is gone with the page.
window.addEventListener("beforeunload", (event) => {
  if (isConnected && !scene?.isKept && state?.canUndo && state.revision !== savedRevision) event.preventDefault();
});

// ---------- messages of the session

function read(message) {
  const readers = {
    scene: readScene, state: readState, numbers: readNumbers, variants: readVariants, proposals: readProposals, view: readView,
    coverage: readCoverage, doing: readDoing, background: dialogs.readBackground, sensors: (message) => { scene.grid = message.grid; fillGrid(); },
    problem: (message) => notice(message.text), notice: (message) => notice(message.text),
  };
  readers[message.type]?.(message);
}

function connected(isOpen) {
  isConnected = isOpen;
  const banner = find("connection");
  banner.hidden = isOpen;
  banner.textContent = isOpen ? "" : "The connection to place-rsus plan is lost; trying again. What you do now is not saved.";
  find("main").inert = !isOpen;
  if (!isOpen) { numbers = null; showNumbers(); }
}

// What was asked for is not answered: no number is taken for that of what is shown.
function silent(seconds) {
  find("silence").hidden = !seconds;
  find("silence").textContent = seconds ? `place-rsus plan has not answered for ${Math.floor(seconds)} s: plan and numbers are old.` : "";
  if (seconds) find("apr").classList.add("old");
  else showNumbers();
}

let noticeTimer = 0;
function notice(text) {
  find("notice").textContent = text;
  find("notice").hidden = !text;
  clearTimeout(noticeTimer);
  if (text) noticeTimer = setTimeout(() => notice(""), 15000);
}

function options(select, values, chosen) {
  select.replaceChildren(...values.map(([value, text, isDisabled]) => {
    const made = element("option", { value, text });
    made.disabled = Boolean(isDisabled);
    return made;
  }));
  if (chosen !== undefined) select.value = chosen;
}

function readScene(message) {
  const isOther = scene && scene.name !== message.name;
  scene = message;
  find("scene-name").textContent = `at ${scene.title}, ${scene.runs.length} runs`;
  find("scene-name").title = scene.name;
  document.title = `Plan at ${scene.title} - place-rsus`;
  map.showScene(scene);
  map.showShares(null);
  if (isOther) selected = null;
  const sites = scene.sites.map((site) => [site.id, `${site.id} (${site.kind})`, site.isForbidden]);
  options(find("site"), sites);
  options(find("why-site"), sites);
  options(find("unit-site"), sites);
  const models = scene.sensors.map((model) => [model.name, model.name]);
  options(find("sensor"), models, scene.grid[0]);
  options(find("unit-sensor"), models);
  fillGrid();
  coverage = null;
  chooseSite(find("site").value);
}

function fillGrid() {
  find("grid").replaceChildren(...scene.sensors.map((model) => {
    const label = element("label", {});
    const box = element("input", { type: "checkbox", value: model.name }, label);
    box.checked = scene.grid.includes(model.name);
    box.addEventListener("change", () => line.send({ do: "sensors", names: [...find("grid").querySelectorAll("input:checked")].map((item) => item.value) }));
    label.append(` ${model.name} `);
    return label;
  }));
}

function readState(message) {
  state = message;
  if (!state.units.some((unit) => unit.id === selected)) selected = state.units.at(-1)?.id ?? null;
  find("undo").disabled = !state.canUndo;
  find("redo").disabled = !state.canRedo;
  map.select(selected);
  map.showUnits(state.units);
  showUnits();
  showSiteText();
  showCost();
  find("variant-name").value = state.variants[state.current].name;
  clearTimeout(timer);
  if (numbers && numbers.revision !== state.revision) {
    find("apr").classList.add("old");
    timer = setTimeout(showNumbers, PATIENCE_MS);
  } else showNumbers();
}

function readNumbers(message) {
  numbers = message;
  if (!state || numbers.revision !== state.revision) return;
  clearTimeout(timer);
  showNumbers();
}

const isCurrent = () => Boolean(numbers && state && numbers.revision === state.revision);

function showNumbers() {
  const [output, source] = [find("apr"), find("source")];
  output.classList.remove("old");
  const isKnown = isCurrent() && numbers.source !== "none";
  output.textContent = isKnown ? numbers.apr : isCurrent() ? "No sensor yet" : "computing \u2026";
  source.className = `badge ${isKnown ? numbers.source : ""}`;
  source.textContent = !isCurrent() ? "computing" : {
    table: "by the detection table; the evaluator follows",
    evaluator: "by the evaluator, as place-rsus evaluate",
    none: "nothing is mounted",
  }[numbers.source];
  find("main").setAttribute("aria-busy", String(!isCurrent()));
  output.dataset.revision = isKnown ? numbers.revision : "";
  const isExact = isKnown && numbers.source === "evaluator";
  find("beside").textContent = isExact ? `Together with the car's own sensors ${numbers.withVut}; by the car's own sensors alone ${numbers.vut}.${numbers.oneFails ? ` If the worst unit fails, ${numbers.oneFails} are left.` : ""}` : "";
  fillShares("by-case", isKnown ? numbers.byCase : null);
  fillShares("by-approach", isKnown ? numbers.byApproach : null);
  fillShares("by-road-user", isKnown ? numbers.byRoadUser : null);
  map.showShares(isKnown ? numbers.byArm : null);
  showPrivate();
  showUnits();
  showLost();
}

// ---------- private areas

function sharesOf(seen, isOne) {
  return seen.map((item) => `${isOne ? "" : `${item.unit} `}${item.share}${item.isTooMuch ? " (more than is allowed)" : ""}`).join(", ");
}

function showPrivate() {
  if (!scene) return;
  const areas = isCurrent() && numbers.source !== "none" ? numbers.private || [] : null;
  const n = scene.private.length;
  find("private").hidden = find("private-key").hidden = !n;
  if (!n) return;
  find("private-text").textContent = areas === null ? "" : areas.length ? "" : `No camera has ${n === 1 ? "the private area" : `any of the ${n} private areas`} in its picture.`;
  find("private-list").replaceChildren(...(areas || []).map((item) => element("li", { text: `${item.area}: ${sharesOf(item.seen)}` })));
  const of = (areas || []).map((item) => [item.area, item.seen.filter((one) => one.unit === selected)]).filter(([, seen]) => seen.length);
  find("unit-private").hidden = !current() || areas === null;
  find("unit-private").textContent = of.length ? `Private areas in its picture: ${of.map(([area, seen]) => `${area} ${sharesOf(seen, true)}`).join("; ")}.` : "No private area in its picture.";
  showSeen(of.length > 0);
}

// Places that the chosen sensor sees; while it is turned only the newest answer is drawn.
let seenOf = "", isAsking = false;
async function showSeen(isAny) {
  const wanted = isAny ? `${selected} ${state.revision}` : "";
  if (!wanted) { seenOf = ""; map.showSeen([]); return; }
  if (isAsking || wanted === seenOf) return;
  isAsking = true;
  try {
    map.showSeen(await ask("private", { unit: selected }));
    seenOf = wanted;
  } catch {
    map.showSeen([]); // it was taken down meanwhile
  } finally {
    isAsking = false;
  }
  if (isCurrent()) showPrivate();
}

function fillShares(id, shares) {
  const [body] = find(id).tBodies;
  body.replaceChildren();
  for (const [name, share] of Object.entries(shares || {})) {
    const row = element("tr", {}, body);
    element("th", { scope: "row", text: name }, row);
    element("td", { class: "number", text: share }, row);
  }
}

function showCost() {
  const cost = state.cost;
  find("cost").textContent = cost ? `Costs ${cost.all}: sensors ${cost.sensors}, poles ${cost.sites}.` : "";
  find("cost").title = cost ? cost.assumed.join(" ") : "";
}

// ---------- mounted sensors

// Buttons stay as long as their units do: one that is replaced under a pressed pointer is never clicked.
let shownUnits = "";
function showUnits() {
  if (!state) return fillUnit();
  const alone = isCurrent() ? numbers.units || {} : {};
  const list = find("units"), ids = JSON.stringify(state.units.map((unit) => unit.id));
  if (ids !== shownUnits) {
    shownUnits = ids;
    const focused = document.activeElement?.dataset?.chip;
    list.replaceChildren(...state.units.map(({ id }) => {
      const item = element("li", {});
      element("button", { type: "button", "data-chip": id }, item).addEventListener("click", () => chooseUnit(id));
      return item;
    }));
    if (focused) list.querySelector(`[data-chip="${CSS.escape(focused)}"]`)?.focus();
  }
  state.units.forEach(({ id, title }, index) => {
    const [button, text] = [list.children[index].firstChild, alone[id] ? `${id} ${alone[id]}` : id];
    if (button.textContent !== text) button.textContent = text;
    button.title = title;
    button.setAttribute("aria-pressed", id === selected);
  });
  fillUnit();
}

const current = () => state?.units.find((unit) => unit.id === selected);

function fillUnit() {
  const unit = current();
  find("unit").hidden = !unit;
  if (!unit) return;
  const reach = map.viewOf(unit.id)?.reachM;
  find("unit-text").textContent = `${unit.title}${unit.site ? `, at ${unit.site}` : ""}${reach ? `; its detector reaches ${reach.toFixed(0)} m` : ""}`;
  for (const [id, field] of Object.entries(FIELDS)) {
    const value = Number(field.of(unit).toFixed(field.digits));
    for (const input of [find(id), find(`${id}-slide`)]) {
      if (document.activeElement === input && input.type === "number") continue;
      if (id === "height") [input.min, input.max] = unit.heightRange;
      if (id === "fov" && unit.fovRange) [input.min, input.max] = unit.fovRange;
      input.value = value;
    }
  }
  find("fov-row").hidden = !unit.fovRange;
  find("unit-site").value = unit.site;
  find("unit-sensor").value = unit.sensor;
}

function readView(view) {
  map.showView(view);
  if (view.unit === selected) fillUnit();
}

function chooseUnit(id) {
  selected = id;
  map.select(id);
  showUnits();
  showPrivate();
}

let typing = { id: "", gesture: "" };
for (const [id, field] of Object.entries(FIELDS)) {
  for (const input of [find(id), find(`${id}-slide`)]) {
    input.addEventListener("input", () => {
      if (input.value === "" || !Number.isFinite(input.valueAsNumber) || !current()) return;
      if (typing.id !== input.id) typing = { id: input.id, gesture: `${input.id} ${Date.now()}` };
      put({ do: "change", unit: selected, [field.name]: input.valueAsNumber, gesture: typing.gesture });
    });
    input.addEventListener("change", () => { typing = { id: "", gesture: "" }; });
    input.addEventListener("blur", fillUnit);
  }
}
find("unit").addEventListener("submit", (event) => event.preventDefault());
find("unit-site").addEventListener("change", (event) => line.send({ do: "change", unit: selected, site: event.target.value }));
find("unit-sensor").addEventListener("change", (event) => line.send({ do: "change", unit: selected, sensor: event.target.value }));
find("remove").addEventListener("click", () => line.send({ do: "remove", unit: selected }));

function chooseSite(id) {
  find("site").value = id;
  if (!scene.sites.find((site) => site.id === id)?.isForbidden) find("why-site").value = id;
  map.showSite(id);
  showSiteText();
}

function showSiteText() {
  const site = scene?.sites.find((item) => item.id === find("site").value);
  if (!site) return;
  const n = state ? state.units.filter((unit) => unit.site === site.id).length : 0;
  find("site-text").textContent = `${site.kind}, ${site.low} to ${site.high} m; ${n} of ${site.capacity} units are mounted there.`;
  find("hang").disabled = site.isForbidden || n >= site.capacity;
}

function hang(site, aim) {
  const message = { do: "add", site, sensor: find("sensor").value };
  const isRing = scene.sensors.find((model) => model.name === message.sensor)?.isRing;
  if (aim) Object.assign(message, { yaw_deg: aim.yaw }, isRing ? {} : { pitch_deg: Math.max(-90, aim.pitch) }); // what scans all round stays level
  selected = null; // the new one is the last
  line.send(message);
}
find("site").addEventListener("change", (event) => chooseSite(event.target.value));
find("hang").addEventListener("click", () => hang(find("site").value));

// ---------- lost runs

function showLost() {
  const list = find("lost");
  const isKnown = isCurrent() && numbers.source !== "none";
  const lost = isKnown ? numbers.lost.filter(([, , counts]) => counts) : [];
  const words = find("lost-filter").value.toLowerCase().split(/[\s,]+/).filter(Boolean);
  const shown = lost.filter(([index, outcome]) => words.every((word) => `${scene.runs[index].title} ${outcome}`.toLowerCase().includes(word)));
  find("lost-text").textContent = !isKnown ? "" : lost.length === 0 ? "None: every run is avoided." : `${lost.length} of ${scene.runs.length}${words.length ? `, ${shown.length} of them as asked for` : ""}${shown.length > MOST_LOST ? `; the first ${MOST_LOST}` : ""}. Choose one to see why.`;
  list.replaceChildren(...shown.slice(0, MOST_LOST).map(([index, outcome]) => {
    const item = element("li", {});
    const button = element("button", { type: "button", text: `${scene.runs[index].title}: ${outcome}` }, item);
    button.addEventListener("click", () => dialogs.showRun(scene.runs[index], outcome));
    return item;
  }));
  list.hidden = !shown.length;
}
find("lost-filter").addEventListener("input", showLost);

// ---------- the optimiser

document.querySelectorAll("[data-ask]").forEach((button) => button.addEventListener("click", () => {
  const request = button.dataset.ask;
  const message = { do: "ask", request };
  if (request === "complete") message.units = find("complete-to").valueAsNumber || 0;
  if (request === "why-not") message.site = find("why-site").value;
  line.send(message);
}));
find("cancel").addEventListener("click", () => line.send({ do: "cancel" }));

function readDoing(message) {
  const text = message.stage ? `${message.who}: ${message.stage}${message.total ? `, ${message.done} of ${message.total}` : ""}` : "";
  if (message.who === "optimiser") {
    find("doing").textContent = text;
    find("cancel").hidden = !text;
    document.querySelectorAll("[data-ask]").forEach((button) => { button.disabled = Boolean(text); });
  } else if (message.who === "rays") {
    if (text) notice("Rays are being prepared; the first time on a machine that takes a minute.");
    else notice("");
  } else if (isCurrent() && numbers.source === "table") {
    find("source").textContent = `by the detection table; the evaluator ${text ? "is at work" : "follows"}`;
  }
}

function readProposals(message) {
  proposals = message.proposals;
  if (!proposals.some((each) => each.number === offered)) offered = null;
  map.showOffered(proposals.find((each) => each.number === offered)?.drawn);
  find("proposals").replaceChildren(...proposals.map((each) => {
    const item = element("li", {});
    element("h3", { text: each.title }, item);
    element("p", { text: each.words }, item);
    element("p", { text: each.source === "evaluator" ? `By the evaluator: APR ${each.apr}.` : each.problem || "By the evaluator: computing \u2026" }, item);
    const row = element("div", { class: "row" }, item);
    const add = (text, act) => { const made = element("button", { type: "button", text }, row); made.addEventListener("click", act); return made; };
    add("Show on the plan", () => { offered = offered === each.number ? null : each.number; readProposals({ proposals }); }).setAttribute("aria-pressed", offered === each.number);
    add("Take it over", () => line.send({ do: "take", number: each.number }));
    add("As a variant", () => line.send({ do: "take", number: each.number, as_variant: true }));
    add("Drop", () => line.send({ do: "drop", number: each.number }));
    return item;
  }));
}

// ---------- variants

function readVariants(message) {
  const rows = message.variants;
  const cases = [...new Set(rows.flatMap((row) => Object.keys(row.byCase)))];
  const table = find("variants");
  table.tHead.replaceChildren();
  const head = element("tr", {}, table.tHead);
  ["", "units", "cost", "APR", "one fails", ...cases].forEach((text) => element("th", { scope: "col", text }, head));
  const [body] = table.tBodies;
  const focused = document.activeElement?.dataset?.variant;
  body.replaceChildren();
  rows.forEach((row, index) => {
    const line_ = element("tr", {}, body);
    const name = element("th", { scope: "row" }, line_);
    const button = element("button", { type: "button", text: row.name, "data-variant": index, "aria-current": index === state?.current }, name);
    button.addEventListener("click", () => line.send({ do: "select-variant", index }));
    const apr = { none: row.units ? row.problem || "computing \u2026" : "", table: `${row.apr} (table)`, evaluator: row.apr }[row.source];
    [row.units, row.cost, apr, row.oneFails, ...cases.map((name_) => row.byCase[name_] ?? "")].forEach((text) => element("td", { text }, line_));
  });
  if (focused !== undefined) body.querySelector(`[data-variant="${focused}"]`)?.focus();
}
find("copy-variant").addEventListener("click", () => line.send({ do: "add-variant" }));
find("remove-variant").addEventListener("click", () => line.send({ do: "remove-variant" }));
find("variant-name").addEventListener("change", (event) => line.send({ do: "rename-variant", name: event.target.value }));

// ---------- the plan's own buttons

find("undo").addEventListener("click", () => line.send({ do: "undo" }));
find("redo").addEventListener("click", () => line.send({ do: "redo" }));
find("closer").addEventListener("click", () => map.zoomBy(1.4));
find("farther").addEventListener("click", () => map.zoomBy(1 / 1.4));
find("whole").addEventListener("click", () => map.whole());
find("coverage").addEventListener("change", (event) => {
  line.send({ do: "coverage", is_shown: event.target.checked });
  if (!event.target.checked) { coverage = null; map.showCoverage(null); }
  find("coverage-key").hidden = !event.target.checked;
  find("coverage-key").textContent = "computing \u2026";
});

function readCoverage(message) {
  if (!find("coverage").checked) return;
  coverage = message;
  map.showCoverage(coverage);
  find("coverage-key").hidden = false;
  const codes = [...scene.bands.keys(), 254, 255];
  find("coverage-key").replaceChildren("Of the road, by pixels per metre: ", ...Object.entries(coverage.shares).map(([name, share], index) => {
    const item = element("span", { class: "key" });
    const swatch = element("svg", { width: 12, height: 12, "aria-hidden": "true" }, item);
    element("rect", { width: 12, height: 12, fill: bandColour(codes[index]), stroke: "#333" }, swatch);
    item.append(` ${name} ${share} `);
    return item;
  }));
}

// ---------- the keyboard

// A step by pointer or field: keys go on from it.
function put(step) {
  held.at = 0;
  line.step(step);
}

// Keys may come faster than answers: each goes on from what those before it have asked for.
const KEY_GESTURE_MS = 800, AHEAD_MS = 2500;
const TOLD_AS = { yaw_deg: "yawDeg", pitch_deg: "pitchDeg", height_m: "heightM", fov_deg: "fovDeg" };
let held = { unit: "", key: "", gesture: "", at: 0 }, ahead = {};
function turnBy(changes, key) {
  const unit = current();
  if (!unit) return;
  const since = Date.now() - held.at;
  if (held.unit !== selected || since > AHEAD_MS) ahead = {};
  const isSame = held.unit === selected && held.key === key && since <= KEY_GESTURE_MS;
  held = { unit: selected, key, gesture: isSame ? held.gesture : `key ${Date.now()}`, at: Date.now() };
  const wanted = { ...unit };
  for (const [name, value] of Object.entries(ahead)) wanted[TOLD_AS[name]] = value;
  Object.assign(ahead, changes(wanted));
  line.step({ do: "change", unit: selected, ...ahead, gesture: held.gesture });
}

// Sliders, boxes and lists take arrows and letters, but nothing that could be undone or deleted there; so do numbers that are done.
const takesKeys = (field) => field.matches("input, select, textarea, [contenteditable]") || field.closest("dialog[open]");
const takesText = (field) => field.closest("dialog[open]") || (field.matches("input:not([type=range], [type=checkbox]), textarea, [contenteditable]") && !(field.id in FIELDS && !typing.id));

document.addEventListener("keydown", (event) => {
  const isWriting = takesKeys(event.target), key = event.key;
  if (key === "Escape" && map.giveUp()) { event.preventDefault(); notice(""); return; }
  if ((event.ctrlKey || event.metaKey) && !event.altKey && !takesText(event.target)) {
    const isRedo = key.toLowerCase() === "y" || (key.toLowerCase() === "z" && event.shiftKey);
    if (isRedo || key.toLowerCase() === "z") { event.preventDefault(); held.at = 0; line.send({ do: isRedo ? "redo" : "undo" }); }
    return;
  }
  const isDelete = key === "Delete" && !event.target.matches("input:not([type=range], [type=checkbox]), textarea") && !event.target.closest("dialog[open]");
  if ((isWriting && !isDelete) || event.altKey || event.metaKey || !isConnected) return;
  const step = event.shiftKey ? 10 : 1;
  const within = (value, [low, high]) => Math.min(Math.max(value, low), high);
  const acts = {
    ArrowLeft: () => turnBy((unit) => ({ yaw_deg: unit.yawDeg + step }), key),
    ArrowRight: () => turnBy((unit) => ({ yaw_deg: unit.yawDeg - step }), key),
    ArrowUp: () => turnBy((unit) => ({ pitch_deg: within(unit.pitchDeg + step, [-90, 90]) }), key),
    ArrowDown: () => turnBy((unit) => ({ pitch_deg: within(unit.pitchDeg - step, [-90, 90]) }), key),
    PageUp: () => turnBy((unit) => ({ height_m: within(unit.heightM + 0.25, unit.heightRange) }), key),
    PageDown: () => turnBy((unit) => ({ height_m: within(unit.heightM - 0.25, unit.heightRange) }), key),
    "+": () => current()?.fovRange && turnBy((unit) => ({ fov_deg: within(unit.fovDeg - step, unit.fovRange) }), key),
    "-": () => current()?.fovRange && turnBy((unit) => ({ fov_deg: within(unit.fovDeg + step, unit.fovRange) }), key),
    Delete: () => current() && line.send({ do: "remove", unit: selected }),
    n: () => stepUnit(1),
    p: () => stepUnit(-1),
    "?": () => dialogs.showHelp(),
  };
  if (!acts[key]) return;
  event.preventDefault();
  acts[key]();
});

function stepUnit(by) {
  const ids = state?.units.map((unit) => unit.id) ?? [];
  if (ids.length) chooseUnit(ids[(ids.indexOf(selected) + by + ids.length) % ids.length]);
}
