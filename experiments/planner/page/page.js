// The planner's page: shows the messages of the session, and sends it what is done here.

import { compareVariants } from "./compare.js";
import { fillDangerKey } from "./danger.js";
import { openDialogs } from "./dialogs.js";
import { bearingOf, createCompass, createSideView, giveUpHandle } from "./handles.js";
import { ask, openLine } from "./line.js";
import { bandColour, createMap } from "./map.js";
import { createQuestion } from "./question.js";
import { createPlayed } from "./run.js";
import { createSeen } from "./seen.js";
import { element } from "./shared.js";
import { createTiles } from "./tiles.js";
import { number, tr, trn } from "./words.js";

const find = (id) => document.getElementById(id);
const PATIENCE_MS = 120; // after a change, before the old number gives way to "computing"
const MOST_LOST = 150;
const STEP_DEG = 15; // of the snapping switch
// Colours of sensors: none of them says anything else on this page (blue: avoided, orange: lost ..).
const UNIT_COLOURS = ["#00795c", "#7a4a1e", "#4b6a00", "#00708a", "#8a6d00", "#5a5a5a"];
const FIELDS = {
  yaw: { name: "yaw_deg", of: (unit) => unit.yawDeg, digits: 1 },
  pitch: { name: "pitch_deg", of: (unit) => unit.pitchDeg, digits: 1 },
  height: { name: "height_m", of: (unit) => unit.heightM, digits: 2 },
  fov: { name: "fov_deg", of: (unit) => unit.fovDeg, digits: 1 },
};

// `selected`: null is none, undefined the newest one, as soon as it is told.
let scene = null, state = null, numbers = null, proposals = [], selected, offered = null;
let mounting = null; // how many sensors there were when one more was asked for
let chosenBefore = null; // the choice when a drag mounted a sensor
let isConnected = false, timer = 0, coverage = null, savedRevision = 0;

const line = openLine({ onMessage: receive, onState: connected, onSilence: silent });
const map = createMap(find("plan"), {
  hover: tellError,
  site: chooseSite,
  unit: chooseUnit,
  aim: (unit, aim, gesture) => change(unit, { yaw_deg: aim.yaw, ...(aim.pitch === undefined ? {} : { pitch_deg: Math.max(-90, aim.pitch) }) }, gesture),
  move: (unit, site) => line.send({ do: "change", unit, site }),
  hang: (site, aim, gesture) => { chosenBefore = selected; chooseSite(site); hang(site, aim, gesture); },
  giveUp,
  snapped,
  refused,
  heightOf: (site) => Math.min(Math.max(8, site.low), site.high),
  putPole,
  poling: (isOn) => {
    find("pole").setAttribute("aria-pressed", isOn);
    if (isOn) find("own-poles").open = true;
    find("ruler-text").textContent = isOn ? tr("Click where a pole should stand; drag a square one to move it; press Escape to finish.") : "";
  },
  measured: (metres) => { find("ruler-text").textContent = `${number(metres, 2)} m`; },
  measuring: (isOn) => {
    find("ruler").setAttribute("aria-pressed", isOn);
    find("ruler-text").textContent = isOn ? tr("Click two points, or drag from one to the other; press Escape to finish.") : "";
  },
});
const onHandles = {
  turn: (unit, yaw_deg, gesture) => change(unit, { yaw_deg }, gesture),
  tilt: (unit, pitch_deg, gesture) => change(unit, { pitch_deg }, gesture),
  raise: (unit, height_m, gesture) => change(unit, { height_m }, gesture),
  key: (key, name, by) => turnBy((unit) => ({
    yaw: () => ({ yaw_deg: unit.yawDeg + by }),
    tilt: () => ({ pitch_deg: within(unit.pitchDeg + by, [-90, 90]) }),
    height: () => ({ height_m: within(unit.heightM + by, unit.heightRange) }),
  }[name]()), `${name} ${key}`),
  giveUp, snapped, refused,
};
const tiles = createTiles({ map, notice });
const compass = createCompass(find("compass-holder"), onHandles), sideView = createSideView(find("side-holder"), onHandles);
const played = createPlayed({ map, unitsNow: () => unitsNow(), onClose: () => { markPlayed(); seen.changed(); }, onFrame: () => seen.changed(), onWhy: () => { const index = playedIndex(); dialogs.showRun(scene.runs[index], outcomeOf(index) ?? tr("avoided")); } });
const seen = createSeen({ scene: () => scene, unitNow: () => state?.units.find((unit) => unit.id === selected), runNow: () => (played.run() ? { run: played.run(), frame: played.frame() } : null) });
const question = createQuestion({ send: (message) => line.send(message) });
const comparison = compareVariants({ map, state: () => state, cases: () => scene.cases });
const dialogs = openDialogs({ map, notice, send: (message) => line.send(message), scene: () => scene, state: () => state, saved: () => { savedRevision = state.revision; } });

// A plan that is in no file is gone with the page.
window.addEventListener("beforeunload", (event) => {
  if (isConnected && !scene?.isKept && state?.canUndo && state.revision !== savedRevision) event.preventDefault();
});

// ---------- messages of the session

// Messages redraw these lists, and a button that is replaced while it is pressed is never clicked: they wait for its release.
const REDRAWN = ["#proposals", "#lost", "#variants"].map((list) => `${list} button`).join(", ");
let isPressed = false, waiting = [];
document.addEventListener("pointerdown", (event) => { isPressed = event.target.closest(REDRAWN) !== null; }, true);
const release = () => setTimeout(() => { // after the click, which follows the release at once
  const late = waiting;
  isPressed = false;
  waiting = [];
  late.forEach(read);
});
for (const end of ["pointerup", "pointercancel"]) document.addEventListener(end, release, true);
// A release that another window gets is not told.
document.addEventListener("pointermove", (event) => { if (isPressed && !event.buttons) release(); }, true);

function receive(message) {
  if (isPressed) waiting.push(message);
  else read(message);
}

function read(message) {
  const readers = {
    scene: readScene, state: readState, numbers: readNumbers, variants: readVariants, proposals: readProposals, view: readView,
    coverage: (message) => readGrid(message, "coverage", [...scene.bands.keys(), 254, 255], tr("Share of the road by pixels per metre:")), errors: (message) => readGrid(message, "errors", [0, 1, 2, 3, 254, 255], tr("Share of the road by position error with calibrated aims (one standard deviation of a frame, cameras only):")), question: (message) => { question.read(message); tellMeanings(); }, doing: readDoing, background: dialogs.readBackground, sensors: (message) => { scene.grid = message.grid; fillGrid(); },
    problem: (message) => { map.forgetLate(); settle(); question.refused(); mounting = null; awaitsPole = false; notice(message.text); }, notice: (message) => notice(message.text),
  };
  readers[message.type]?.(message);
}

function connected(isOpen) {
  isConnected = isOpen;
  const banner = find("connection");
  banner.hidden = isOpen;
  banner.textContent = isOpen ? "" : tr("The connection to place-rsus plan is lost; trying again. What you do now is not saved.");
  find("main").inert = !isOpen;
  if (!isOpen) { numbers = null; live.clear(); showNumbers(); }
  else seen.again();
}

// What was asked for is not answered: no number is taken for that of what is shown.
function silent(seconds) {
  find("silence").hidden = !seconds;
  find("silence").textContent = seconds ? tr("place-rsus plan has not answered for {n} s: plan and numbers are old.", { n: Math.floor(seconds) }) : "";
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

// New items of a list; the button that has the focus keeps it, by its data-key.
function redraw(list, items) {
  const focused = list.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  list.replaceChildren(...items);
  if (focused !== undefined) list.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
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
  const site_ = find("site").value;
  fixedSites = scene.sites;
  shownPoles = "[]";
  find("scene-name").textContent = trn("at {scene}, {n} run", "at {scene}, {n} runs", scene.runs.length, { scene: scene.title });
  find("scene-name").title = scene.name;
  document.title = `${tr("Plan at {scene}", { scene: scene.title })} - place-rsus`;
  map.showScene(scene);
  map.showShares(null);
  if (isOther) { selected = undefined; mounting = null; locked.clear(); }
  if (isOther || !scene.runs.some((run) => run.id === played.run())) played.close();
  numbers = null;
  fillSites();
  const models = scene.sensors.map((model) => [model.name, model.name]);
  options(find("sensor"), models, scene.grid[0]);
  options(find("unit-sensor"), models);
  fillGrid();
  coverage = null;
  chooseSite(isOther || !scene.sites.some((site) => site.id === site_) ? find("site").value : site_);
  seen.again();
  dialogs.junctions.readScene(scene);
  tiles.readScene(scene.tiles);
}

// Poles of one's own come with the state: they are undone as all else is.
let fixedSites = [], shownPoles = "[]", awaitsPole = false;
function fillSites() {
  const sites = scene.sites.map((site) => [site.id, site.isOwn ? tr("{id} (your own {kind})", site) : `${site.id} (${site.kind})`, site.isForbidden]);
  for (const id of ["site", "why-site", "unit-site"]) options(find(id), sites, scene.sites.some((site) => site.id === find(id).value) ? find(id).value : undefined);
}

function readPoles(poles) {
  if (JSON.stringify(poles) === shownPoles) return;
  const before = JSON.parse(shownPoles).map((pole) => pole.id);
  shownPoles = JSON.stringify(poles);
  map.showSites([...fixedSites, ...poles]);
  fillSites();
  const added = poles.find((pole) => !before.includes(pole.id));
  if (added && awaitsPole) chooseUnit(null);
  chooseSite(added && awaitsPole ? added.id : find("site").value);
  awaitsPole = false;
}

function putPole([x, y], site = "") {
  const held = state.units.find((unit) => unit.site === site && locked.has(unit.id));
  if (site && held) { refused(held.id); return; }
  awaitsPole = !site;
  line.send({ do: "pole", east_m: x / 100, north_m: y / 100, site });
}

const ownPole = () => scene?.sites.find((site) => site.isOwn && site.id === find("site").value);
function removePole() {
  if (ownPole()) line.send({ do: "remove-pole", site: ownPole().id });
}
const typedPole = () => {
  const place = ["pole-east", "pole-north"].map((id) => 100 * find(id).valueAsNumber);
  if (place.every(Number.isFinite)) return place;
  notice(tr("Type both numbers, east and north of the origin in metres."));
  return null;
};
find("pole").addEventListener("click", () => map.pole(!map.isPoling()));
find("put-pole").addEventListener("click", () => { const place = typedPole(); if (place) putPole(place); });
find("move-pole").addEventListener("click", () => { const place = typedPole(); if (place) putPole(place, ownPole().id); });
find("remove-pole").addEventListener("click", removePole);

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
  keepLocks(message);
  state = message;
  readPoles(message.poles);
  const last = state.units.at(-1)?.id ?? null;
  if (selected === undefined) selected = last;
  if (mounting !== null && state.units.length > mounting) { selected = last; mounting = null; } // the new one
  else if (!state.units.some((unit) => unit.id === selected)) selected = null;
  if (!line.isAsking()) live.clear();
  find("undo").disabled = !state.canUndo;
  find("redo").disabled = !state.canRedo;
  map.select(selected);
  map.showUnits(unitsNow());
  showUnits();
  comparison.stateChanged();
  if (state.units.length) played.old();
  else played.close();
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

// What each number means, one hover away.
const OF_PART = () => `${tr("Share of the runs of this row that is avoided, with the same weights.")} ${question.meaning()}`;
function tellMeanings() {
  const meaning = question.meaning();
  find("apr").title = `${tr("APR, the share of the runs that all mounted sensors together avoid.")} ${meaning}`;
  find("beside").title = tr("Shares of the same runs with the same weights. {meaning} The most needed unit is the one whose failure leaves the least.", { meaning });
  find("source").title = tr("The detection table gives numbers at once, from rays to points on each road user. The evaluator renders every frame, as place-rsus evaluate does.");
  for (const id of ["by-case", "by-approach", "by-road-user"]) find(id).title = OF_PART();
  find("lost-text").title = tr("These are numbers of runs, not weights: each run counts once.");
  showUnits();
}

const within = (value, [low, high]) => Math.min(Math.max(value, low), high);
const isCurrent = () => Boolean(numbers && state && numbers.revision === state.revision);

function showNumbers() {
  const [output, source] = [find("apr"), find("source")];
  output.classList.remove("old");
  const isKnown = isCurrent() && numbers.source !== "none";
  output.textContent = isKnown ? numbers.apr : isCurrent() ? tr("No sensor yet") : tr("computing \u2026");
  source.className = `badge ${isKnown ? numbers.source : ""}`;
  source.textContent = !isCurrent() ? tr("computing") : {
    table: tr("by the detection table; the evaluator follows"),
    evaluator: tr("by the evaluator, as place-rsus evaluate"),
    none: tr("nothing is mounted"),
  }[numbers.source];
  find("main").setAttribute("aria-busy", String(!isCurrent()));
  output.dataset.revision = isKnown ? numbers.revision : "";
  const isExact = isKnown && numbers.source === "evaluator";
  // While it waits it keeps its lines: what is dragged below does not move away from the pointer.
  find("beside").classList.toggle("waiting", !isExact);
  if (isExact || !state?.units.length) find("beside").textContent = isExact ? besideWords().join(" ") : "";
  fillShares("by-case", isKnown ? numbers.byCase : null);
  fillShares("by-approach", isKnown ? numbers.byApproach : null);
  fillShares("by-road-user", isKnown ? numbers.byRoadUser : null);
  map.showShares(isKnown ? numbers.byArm : null);
  showPrivate();
  showUnits();
  showLost();
  showDanger();
  if (isExact) playAgain();
}

// What it is with the car's own sensors, if one unit fails, and what is left to do.
function besideWords() {
  const words = [tr("For cars with their own sensors {withVut}, instead of {vut} without the roadside.", numbers)];
  if (numbers.oneFails) words.push(tr("If the most needed unit fails, {oneFails} remain.", numbers));
  const n = lostRuns().length;
  // Said of none, too: the panel below keeps its place while a sensor is dragged.
  words.push(n ? tr("Runs lost: {n} of {all}, listed below.", { n, all: scene.runs.length }) : tr("Runs lost: none of {all}.", { all: scene.runs.length }));
  return words;
}

// ---------- private areas

function sharesOf(seen, isOne) {
  return seen.map((item) => `${isOne ? "" : `${item.unit} `}${item.isTooMuch ? tr("{share} (more than is allowed)", item) : item.share}`).join(", ");
}

function showPrivate() {
  if (!scene) return;
  const areas = isCurrent() && numbers.source !== "none" ? numbers.private || [] : null;
  const n = scene.private.length;
  find("private").hidden = find("private-key").hidden = !n;
  if (!n) return;
  find("private-text").textContent = areas === null ? "" : areas.length ? "" : trn("No camera has the private area in its picture.", "No camera has any of the {n} private areas in its picture.", n);
  find("private-list").replaceChildren(...(areas || []).map((item) => element("li", { text: `${item.area}: ${sharesOf(item.seen)}` })));
  const of = (areas || []).map((item) => [item.area, item.seen.filter((one) => one.unit === selected)]).filter(([, seen]) => seen.length);
  find("unit-private").hidden = !current() || areas === null;
  find("unit-private").textContent = of.length ? tr("Private areas in its picture: {areas}.", { areas: of.map(([area, seen]) => `${area} ${sharesOf(seen, true)}`).join("; ") }) : tr("No private area in its picture.");
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
    const title = scene.cases[name] ?? "";
    const named = element("th", { scope: "row", text: name, title }, row);
    if (title) element("span", { class: "unseen", text: `: ${title}` }, named);
    element("td", { class: "number", text: share, title: OF_PART() }, row);
  }
}

function showCost() {
  const cost = state.cost;
  find("cost").textContent = cost ? [tr("Costs {all}: sensors {sensors}, poles {sites}.", cost), cost.kept].join(" ").trim() : "";
  find("cost").title = cost ? [tr("Each mounted sensor and each pole in use counts once."), ...cost.assumed].join(" ") : "";
}

// ---------- mounted sensors

// These buttons stay as long as their units do, and numbers change in them.
let shownUnits = "";
function showUnits() {
  if (!state) return fillUnit();
  const alone = isCurrent() ? numbers.units || {} : {};
  const list = find("units"), ids = JSON.stringify(state.units.map((unit) => unit.id));
  if (ids !== shownUnits) {
    shownUnits = ids;
    redraw(list, state.units.map(({ id }) => {
      const item = element("li", {});
      element("button", { type: "button", "data-chip": id, "data-key": id }, item).addEventListener("click", () => chooseUnit(id));
      return item;
    }));
  }
  state.units.forEach(({ id, label, title }, index) => {
    const button = list.children[index].firstChild, unit = `${label}${alone[id] ? ` ${alone[id]}` : ""}`, text = locked.has(id) ? tr("{unit}, locked", { unit }) : unit;
    if (button.textContent !== text) button.textContent = text;
    button.title = alone[id] ? `${tr("{unit}; avoids {share} on its own.", { unit: title, share: alone[id] })} ${question.meaning()}` : title;
    button.setAttribute("aria-pressed", id === selected);
  });
  fillUnit();
}

const current = () => { const unit = state?.units.find((each) => each.id === selected); return unit && now(unit); };

function fillUnit() {
  const unit = current();
  seen.changed();
  find("unit").hidden = !unit;
  if (!unit) return;
  const reach = map.viewOf(unit.id)?.reachM;
  const told = { unit: unit.title, site: unit.site, reach: reach ? number(reach, 0) : "\u2026" };
  find("unit-text").textContent = unit.site ? tr("{unit}, at {site}; its detector reaches {reach} m", told) : tr("{unit}; its detector reaches {reach} m", told);
  for (const [id, field] of Object.entries(FIELDS)) {
    const value = Number(field.of(unit).toFixed(field.digits));
    for (const input of [find(id), find(`${id}-slide`)]) {
      if (document.activeElement === input && input.type === "number") continue;
      if (id === "height") [input.min, input.max] = unit.heightRange;
      if (id === "fov" && unit.fovRange) [input.min, input.max] = unit.fovRange;
      input.value = value;
    }
  }
  compass.show(unit);
  sideView.show(unit, reach);
  find("bearing").textContent = tr("bearing {angle}\u00b0", { angle: number(bearingOf(unit.yawDeg), 1) });
  for (const field of find("unit").querySelectorAll("input:not(#snap), select, #remove")) field.disabled = unit.isLocked;
  find("lock").setAttribute("aria-pressed", unit.isLocked);
  find("lock").textContent = unit.isLocked ? tr("Unlock") : tr("Lock");
  find("fov-row").hidden = !unit.fovRange;
  find("unit-site").value = unit.site;
  find("unit-sensor").value = unit.sensor;
}

function readView(view) {
  map.showView(view);
  if (view.unit === selected) fillUnit();
}

function chooseUnit(id) {
  if (id === selected) return;
  selected = id;
  map.select(id);
  showUnits();
  showPrivate();
}

const NOT_TYPING = { id: "", gesture: "" };
let typing = NOT_TYPING;

// Escape while a slider is dragged or a number typed: what still comes of it counts no longer.
function giveUpTyping() {
  if (!typing.id || typing.isGivenUp) return false;
  typing.isGivenUp = true;
  giveUp(typing.unit, typing.gesture);
  if (find(typing.id).type === "number") { const { id } = typing; typing = NOT_TYPING; find(id).value = FIELDS[id].of(current()).toFixed(FIELDS[id].digits); }
  return true;
}
for (const [id, field] of Object.entries(FIELDS)) {
  for (const input of [find(id), find(`${id}-slide`)]) {
    input.addEventListener("input", () => {
      if (input.value === "" || !Number.isFinite(input.valueAsNumber) || !current()) return;
      if (typing.id !== input.id) typing = { id: input.id, unit: selected, gesture: `${input.id} ${Date.now()}` };
      if (!typing.isGivenUp) change(selected, { [field.name]: input.valueAsNumber }, typing.gesture);
    });
    input.addEventListener("change", () => { const wasGivenUp = typing.isGivenUp; typing = NOT_TYPING; if (wasGivenUp) fillUnit(); });
    input.addEventListener("blur", fillUnit);
  }
}
find("unit").addEventListener("submit", (event) => event.preventDefault());
find("unit-site").addEventListener("change", (event) => line.send({ do: "change", unit: selected, site: event.target.value }));
find("unit-sensor").addEventListener("change", (event) => line.send({ do: "change", unit: selected, sensor: event.target.value }));
find("remove").addEventListener("click", remove);
find("lock").addEventListener("click", toggleLock);
find("copy-unit").addEventListener("click", copy);
find("paste-unit").addEventListener("click", paste);

function remove() {
  if (!current() || refused(selected)) return;
  const hasFocus = find("unit").contains(document.activeElement);
  line.send({ do: "remove", unit: selected });
  if (hasFocus) find("units-title").focus();
}

// ---------- what is turned is drawn at once; the session's answer comes later

const live = new Map(); // by unit: what was asked for, and is not answered yet
const TOLD_AS = { yaw_deg: "yawDeg", pitch_deg: "pitchDeg", height_m: "heightM", fov_deg: "fovDeg" };

function now(unit) {
  const asked = Object.entries(live.get(unit.id) ?? {}).map(([name, value]) => [TOLD_AS[name], value]);
  const index = state.units.findIndex((each) => each.id === unit.id);
  return { ...unit, ...Object.fromEntries(asked), colour: UNIT_COLOURS[index % UNIT_COLOURS.length], isLive: asked.length > 0, isLocked: locked.has(unit.id) };
}
const unitsNow = () => state?.units.map(now) ?? [];

// Each step has all that those before it have asked for: of those that wait only the newest is sent.
function change(id, changes, gesture) {
  const unit = state.units.find((each) => each.id === id);
  if (!unit || refused(id)) return;
  if ("yaw_deg" in changes) changes.yaw_deg = 180 - ((((180 - changes.yaw_deg) % 360) + 360) % 360);
  const asked = { ...live.get(id), ...changes };
  const inRange = ([name, value]) => !(name === "height_m" && (value < unit.heightRange[0] || value > unit.heightRange[1])) && !(name === "fov_deg" && unit.fovRange && (value < unit.fovRange[0] || value > unit.fovRange[1])) && !(name === "pitch_deg" && Math.abs(value) > 90);
  // What cannot be is sent, so that the answer says why, but not drawn.
  if (Object.entries(asked).every(inRange)) live.set(id, asked);
  line.step({ do: "change", unit: id, ...asked, gesture });
  map.turn(now(unit));
  if (id === selected) fillUnit();
}

// The session has refused something, or a gesture was given up: what it has told last is so.
function settle() {
  live.clear();
  if (!state) return;
  map.showUnits(unitsNow());
  fillUnit();
}

function giveUp(unit, gesture) {
  if (unit === null) { // the sensor just mounted goes: the next key is already for the one chosen before
    mounting = null;
    chooseUnit(chosenBefore);
  }
  line.send({ do: "revert", gesture });
  settle();
}

function snapped(yaw) {
  return find("snap").checked ? STEP_DEG * Math.round(yaw / STEP_DEG) : yaw;
}

// ---------- locked units: of this page alone, by name

const locked = new Set();

function refused(id) {
  if (locked.has(id)) notice(tr("{unit} is locked: unlock it first (L).", { unit: id }));
  return locked.has(id);
}

function toggleLock() {
  if (!current()) return;
  if (!locked.delete(selected)) locked.add(selected);
  map.showUnits(unitsNow());
  showUnits();
}

// The name of a unit that is gone may be another's next; that of another variant stays locked.
function keepLocks(message) {
  if (!state || message.current !== state.current || message.variants.length !== state.variants.length) return;
  const ids = new Set(message.units.map((unit) => unit.id));
  state.units.forEach((unit) => { if (!ids.has(unit.id)) locked.delete(unit.id); });
}

// ---------- copy and paste: the copy keeps height, lens and angles, on whichever pole

let copied = null;

function copy() {
  const unit = current();
  if (!unit) return;
  copied = { sensor: unit.sensor, yaw_deg: unit.yawDeg, pitch_deg: unit.pitchDeg, height_m: unit.heightM, ...(unit.fovRange ? { fov_deg: unit.fovDeg } : {}) };
  find("paste-unit").disabled = false;
  notice(tr("{unit} is copied; press Ctrl+V to paste the copy on the chosen pole.", { unit: unit.id }));
}

function paste() {
  if (!copied) { notice(tr("Nothing is copied yet: choose a sensor and press Ctrl+C.")); return; }
  add({ site: find("site").value, ...copied });
}

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
  find("site-text").textContent = tr("{kind}, {low} to {high} m; {n} of {all} units are mounted there; {price} once.", { ...site, low: number(site.low), high: number(site.high), n, all: site.capacity });
  find("hang").disabled = site.isForbidden || n >= site.capacity;
  find("move-pole").disabled = find("remove-pole").disabled = !site.isOwn;
  if (site.isOwn) ["east", "north"].forEach((name, axis) => { find(`pole-${name}`).value = (site.place[axis] / 100).toFixed(2); });
}

function hang(site, aim, gesture = "") {
  const message = { site, sensor: find("sensor").value, gesture };
  const isRing = scene.sensors.find((model) => model.name === message.sensor)?.isRing;
  if (aim) Object.assign(message, { yaw_deg: aim.yaw }, isRing ? {} : { pitch_deg: Math.max(-90, aim.pitch) }); // what scans all round stays level
  add(message);
}

function add(message) {
  mounting = state?.units.length ?? 0;
  line.send({ do: "add", ...message });
}
find("site").addEventListener("change", (event) => chooseSite(event.target.value));
find("hang").addEventListener("click", () => hang(find("site").value));

// ---------- lost runs

let lostText = "";
// Of runs that the question counts.
const lostRuns = () => numbers.lost.filter(([, , counts]) => counts);
function showLost() {
  const list = find("lost");
  const isKnown = isCurrent() && numbers.source !== "none";
  const lost = isKnown ? lostRuns() : [];
  const words = find("lost-filter").value.toLowerCase().split(/[\s,]+/).filter(Boolean);
  const shown = lost.filter(([index, outcome]) => words.every((word) => `${scene.runs[index].title} ${outcome}`.toLowerCase().includes(word)));
  const counts = { n: lost.length, all: scene.runs.length, shown: shown.length, most: MOST_LOST };
  const said = [words.length ? tr("{n} of {all}; {shown} match the filter.", counts) : tr("{n} of {all}.", counts)];
  if (shown.length > MOST_LOST) said.push(tr("Here are the first {most}.", counts));
  lostText = !isKnown ? "" : lost.length === 0 ? tr("None: every run is avoided.") : [...said, tr("Click a run to see it on the plan, and why it is lost.")].join(" ");
  find("lost-text").textContent = lostText;
  redraw(list, shown.slice(0, MOST_LOST).map(([index, outcome]) => {
    const item = element("li", {});
    const { id, title } = scene.runs[index], isPlayed = id === played.run();
    const button = element("button", { type: "button", text: `${title}: ${outcome}`, title: scene.cases[title.split(" ")[0]] ?? "", "data-run": id, "data-key": id, "aria-pressed": isPlayed }, item);
    button.addEventListener("click", () => play(index));
    return item;
  }));
  list.hidden = !shown.length;
}
find("lost-filter").addEventListener("input", showLost);

const playedIndex = () => scene.runs.findIndex((run) => run.id === played.run());
const outcomeOf = (index) => (isCurrent() && numbers.lost ? numbers.lost.find(([lost]) => lost === index)?.[1] : undefined);
let asked = ""; // the run and the layout that the plan waits for

async function play(index) {
  const run = scene.runs[index], wanted = asked = `${run.id} ${state.revision}`;
  if (played.run() !== run.id) find("lost-text").textContent = tr("Looking up {run} \u2026", { run: run.title });
  try {
    const message = await ask("explain", { run: run.id });
    if (asked !== wanted) return;
    const outcome = outcomeOf(index), { case: what } = message.record;
    played.show(message, { title: `${run.title}${outcome ? `: ${outcome}` : ""} \u2013 ${what}`, isLost: outcome !== undefined });
    markPlayed();
  } catch (error) {
    if (asked !== wanted) return;
    notice(error.message);
    markPlayed();
  }
}

// The evaluator has judged what is shown: is the run that is played still lost, and why?
let playedFor = 0;
function playAgain() {
  const index = playedIndex();
  if (index >= 0 && playedFor !== state.revision) { playedFor = state.revision; play(index); }
}

function markPlayed() {
  find("lost").querySelectorAll("[data-run]").forEach((button) => button.setAttribute("aria-pressed", button.dataset.run === played.run()));
  find("lost-text").textContent = lostText;
}

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
  const text = message.stage && message.total ? tr("{stage}, {done} of {total}", message) : message.stage;
  if (message.who === "setting") question.doing(text);
  else if (message.who === "scene") dialogs.junctions.doing(message);
  else if (message.who === "optimiser") {
    find("doing").textContent = text && tr("optimiser: {stage}", { stage: text });
    find("cancel").hidden = !text;
    document.querySelectorAll("[data-ask]").forEach((button) => { button.disabled = Boolean(text); });
  } else if (message.who === "rays") {
    const preparing = tr("Preparing rays; this takes a minute the first time on a machine.");
    if (text) notice(preparing);
    else if (find("notice").textContent === preparing) notice(""); // a later notice stays
  } else if (isCurrent() && numbers.source === "table") {
    find("source").textContent = text ? tr("by the detection table; the evaluator is at work") : tr("by the detection table; the evaluator follows");
  }
}

function readProposals(message) {
  proposals = message.proposals;
  if (!proposals.some((each) => each.number === offered)) offered = null;
  map.showOffered(proposals.find((each) => each.number === offered)?.drawn);
  redraw(find("proposals"), proposals.map((each) => {
    const item = element("li", {});
    element("h3", { text: each.title }, item);
    element("p", { text: each.words }, item);
    element("p", { text: each.source === "evaluator" ? tr("By the evaluator: APR {apr}.", each) : each.problem || tr("By the evaluator: computing \u2026") }, item);
    const row = element("div", { class: "row" }, item);
    const add = (text, act) => { const made = element("button", { type: "button", text, "aria-label": `${text}: ${each.title}`, "data-key": `${each.number} ${text}` }, row); made.addEventListener("click", act); return made; };
    add(tr("Show on the plan"), () => { offered = offered === each.number ? null : each.number; readProposals({ proposals }); }).setAttribute("aria-pressed", offered === each.number);
    add(tr("Accept"), () => line.send({ do: "take", number: each.number }));
    add(tr("As a variant"), () => line.send({ do: "take", number: each.number, as_variant: true }));
    add(tr("Discard"), () => line.send({ do: "drop", number: each.number }));
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
  const meanings = ["", tr("mounted sensors"), tr("sensors and poles, once"), `${tr("share of the runs that is avoided.")} ${question.meaning()}`, tr("APR that remains if the most needed unit fails")];
  ["", tr("units"), tr("cost"), "APR", tr("one fails"), ...cases].forEach((text, column) => element("th", { scope: "col", text, title: meanings[column] ?? `${scene.cases[text] ?? ""}: ${OF_PART()}` }, head));
  const [body] = table.tBodies;
  redraw(body, rows.map((row, index) => {
    const line_ = element("tr", {});
    const name = element("th", { scope: "row" }, line_);
    const button = element("button", { type: "button", text: row.name, "data-key": index, "aria-current": index === state?.current }, name);
    button.addEventListener("click", () => line.send({ do: "select-variant", index }));
    const apr = { none: row.units ? row.problem || tr("computing \u2026") : "", table: tr("{apr} (table)", row), evaluator: row.apr }[row.source];
    [row.units, row.cost, apr, row.oneFails, ...cases.map((name_) => row.byCase[name_] ?? "")].forEach((text, column) => element("td", { text, title: meanings[column + 1] ?? OF_PART() }, line_));
    return line_;
  }));
  comparison.variantsChanged(rows);
}
find("copy-variant").addEventListener("click", () => line.send({ do: "add-variant" }));
find("remove-variant").addEventListener("click", () => line.send({ do: "remove-variant" }));
find("variant-name").addEventListener("change", (event) => {
  const plain = (name) => name.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, " ").trim();
  const like = state.variants.find((one, index) => index !== state.current && plain(one.name) === plain(event.target.value));
  if (!like) { line.send({ do: "rename-variant", name: event.target.value }); return; }
  notice(tr("\"{name}\" is too similar to \"{other}\": choose a clearly different name.", { name: event.target.value, other: like.name }));
  event.target.value = state.variants[state.current].name;
});

// ---------- the plan's own buttons

find("undo").addEventListener("click", () => line.send({ do: "undo" }));
find("redo").addEventListener("click", () => line.send({ do: "redo" }));
find("closer").addEventListener("click", () => map.zoomBy(1.4));
find("farther").addEventListener("click", () => map.zoomBy(1 / 1.4));
find("whole").addEventListener("click", () => map.whole());
find("ruler").addEventListener("click", () => map.measure(!map.isMeasuring()));
// Pixel density and position error colour the same ground: one of them at a time.
const GRIDS = { coverage: "errors", errors: "coverage" };
for (const [name, other] of Object.entries(GRIDS)) {
  find(name).addEventListener("change", ({ target: { checked } }) => {
    if (checked && find(other).checked) { find(other).checked = false; line.send({ do: other, is_shown: false }); }
    line.send({ do: name, is_shown: checked });
    coverage = null;
    map.showCoverage(null);
    find("coverage-key").hidden = !checked;
    find("coverage-key").textContent = tr("computing \u2026");
    tellError(null);
  });
}

// What the position error is where the mouse is.
function tellError(place) {
  const isShown = find("errors").checked && coverage?.errors && place;
  find("errors-here").hidden = !isShown;
  if (!isShown) return;
  const cell = map.cellAt(coverage, place);
  const [known, byEye] = coverage.errors.map((bytes) => (cell < 0 ? 255 : bytes.charCodeAt(cell)));
  if (known === 255) { find("errors-here").textContent = tr("Here no camera sees an adult."); return; }
  const metres = (byte) => (byte === 254 ? tr("more than {most} m", { most: number(2.53, 2) }) : tr("{n} m", { n: number(byte / 100, 2) }));
  find("errors-here").textContent = tr("Position error here: {known} with calibrated aims, {byEye} with aims set by eye.", { known: metres(known), byEye: metres(byEye) });
}

// Until new numbers come, what is drawn stays, and the legend says that it is old.
function showDanger() {
  const isShown = find("danger").checked, isKnown = isCurrent() && numbers.source !== "none";
  find("danger-key").hidden = !isShown;
  find("danger-key").classList.toggle("old", !isKnown);
  if (isShown && !isKnown && isCurrent()) { find("danger-key").textContent = tr("Nothing is mounted: every run is lost."); map.showDanger(scene.runs.map(({ ends, weight }) => [...ends, weight])); return; }
  if (isShown && !isKnown) return;
  const points = isShown ? numbers.lost.map(([index]) => [...scene.runs[index].ends, scene.runs[index].weight]).filter(([, , weight]) => weight > 0) : [];
  map.showDanger(points);
  if (isShown) fillDangerKey(find("danger-key"), points);
}
find("danger").addEventListener("change", showDanger);

function readGrid(message, name, codes, words) {
  if (!find(name).checked) return;
  // Decoded once: the mouse asks at each step.
  coverage = { ...message, errors: message.errors?.map(atob) };
  map.showCoverage(coverage);
  find("coverage-key").hidden = false;
  find("coverage-key").replaceChildren(`${words} `, ...Object.entries(coverage.shares).map(([name, share], index) => {
    const item = element("span", { class: "key" });
    const swatch = element("svg", { width: 12, height: 12, "aria-hidden": "true" }, item);
    element("rect", { width: 12, height: 12, fill: bandColour(codes[index]), stroke: "#333" }, swatch);
    item.append(` ${name} ${share} `);
    return item;
  }));
}

// ---------- the keyboard

// Steps of one key that follow each other are undone at once.
const KEY_GESTURE_MS = 800;
let held = { unit: "", key: "", gesture: "", at: 0 };
function turnBy(changes, key) {
  const unit = current();
  if (!unit) return;
  const isSame = held.unit === selected && held.key === key && Date.now() - held.at <= KEY_GESTURE_MS;
  held = { unit: selected, key, gesture: isSame ? held.gesture : `key ${Date.now()}`, at: Date.now() };
  change(selected, changes(unit), held.gesture);
}

// Sliders, boxes and lists take arrows and letters, but nothing that could be undone or deleted there; so do numbers that are done.
const takesKeys = (field) => field.matches("input, select, textarea, [contenteditable]") || field.closest("dialog[open]");
const takesText = (field) => field.closest("dialog[open]") || (field.matches("input:not([type=range], [type=checkbox]), textarea, [contenteditable]") && !(field.id in FIELDS && !typing.id));

document.addEventListener("keydown", (event) => {
  const isWriting = takesKeys(event.target), key = event.key;
  if (key === "Escape" && !event.target.closest("dialog[open]")) {
    const isDone = giveUpHandle() || giveUpTyping() || map.giveUp();
    if (isDone) { event.preventDefault(); notice(""); return; }
    if (!isWriting) { event.preventDefault(); chooseUnit(null); return; }
  }
  if ((event.ctrlKey || event.metaKey) && !event.altKey && !takesText(event.target)) {
    const isRedo = key.toLowerCase() === "y" || (key.toLowerCase() === "z" && event.shiftKey);
    if (isRedo || key.toLowerCase() === "z") { event.preventDefault(); held.at = 0; line.send({ do: isRedo ? "redo" : "undo" }); }
    const act = { c: copy, v: paste }[key.toLowerCase()], isOfText = key.toLowerCase() === "c" && !getSelection().isCollapsed;
    if (act && isConnected && !event.shiftKey && !isOfText && (key.toLowerCase() === "v" || current())) { event.preventDefault(); act(); }
    return;
  }
  const isDelete = ["Delete", "Backspace"].includes(key) && !event.target.matches("input:not([type=range], [type=checkbox]), textarea") && !event.target.closest("dialog[open]");
  if ((isWriting && !isDelete) || event.altKey || event.metaKey || !isConnected) return;
  const step = event.shiftKey ? 10 : 1;
  const acts = {
    ArrowLeft: () => turnBy((unit) => ({ yaw_deg: unit.yawDeg + step }), key),
    ArrowRight: () => turnBy((unit) => ({ yaw_deg: unit.yawDeg - step }), key),
    ArrowUp: () => turnBy((unit) => ({ pitch_deg: within(unit.pitchDeg + step, [-90, 90]) }), key),
    ArrowDown: () => turnBy((unit) => ({ pitch_deg: within(unit.pitchDeg - step, [-90, 90]) }), key),
    PageUp: () => turnBy((unit) => ({ height_m: within(unit.heightM + 0.25, unit.heightRange) }), key),
    PageDown: () => turnBy((unit) => ({ height_m: within(unit.heightM - 0.25, unit.heightRange) }), key),
    "+": () => current()?.fovRange && turnBy((unit) => ({ fov_deg: within(unit.fovDeg - step, unit.fovRange) }), key),
    "-": () => current()?.fovRange && turnBy((unit) => ({ fov_deg: within(unit.fovDeg + step, unit.fovRange) }), key),
    Delete: () => (current() ? remove() : removePole()),
    Backspace: () => (current() ? remove() : removePole()),
    o: () => map.pole(!map.isPoling()),
    l: toggleLock,
    m: () => map.measure(!map.isMeasuring()),
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
