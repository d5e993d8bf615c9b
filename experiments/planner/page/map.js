// The junction from above: poles, sensors and their views, arms by the share that is avoided.

import { drawDanger } from "./danger.js";
import { createRunDrawing } from "./run.js";
import { addPatterns, drawGround, drawScale, element, MARKS } from "./shared.js";
import { number, tr } from "./words.js";

const THIN = { "vector-effect": "non-scaling-stroke" };
// What a band of pixel density looks like: the finest first, then those that are coarser or unseen.
export const bandColour = (band) => (band === 255 ? UNSEEN_COLOUR : BAND_COLOURS[band] || COARSE_COLOUR);

const FARTHEST_AIM_CM = 4500, NEAREST_AIM_CM = 150, SITE_REACH_PX = 26, DRAG_PX = 5;
const MARK_PX = 21; // a sensor is drawn so far ahead of its pole, which stays free to press
const HANDLE_PX = 44; // the ring is never nearer to its pole: there a further unit is hung
const WHEEL_STEP = 1.2, PINCH_PX = 38; // zoom of a notch; what a pinch turns to be as much
const NOTCH_PX = 50, STREAM_MS = 250; // the first turn of a wheel is so much, that of a trackpad less; events that belong together
const SNAP_PX = 10, FREE_REACH_M = 60;
const BAND_COLOURS = ["#3f007d", "#54278f", "#6a51a3", "#807dba", "#9e9ac8", "#bcbddc"];
const COARSE_COLOUR = "#e3e3c0", UNSEEN_COLOUR = "#8f8f8f";
const AVOIDED_COLOUR = "#0072B2", LOST_COLOUR = "#D55E00";
const AVOIDED_RGB = [0, 114, 178], MIDDLE_RGB = [225, 225, 225], LOST_RGB = [213, 94, 0];
const LOCK = "M-5 0H5V7H-5ZM-3 0V-3A3 3 0 0 1 3 -3V0";
const ARM_CM = 1400, SEEN_CM = 70;

const degrees = (radians) => radians * 180 / Math.PI;
const radians = (deg) => deg * Math.PI / 180;

// Where the optical axis meets the road, or a place in its direction where it meets none.
function aimOf(unit) {
  const height = 100 * unit.heightM;
  const reach = unit.isRing ? 700 : unit.pitchDeg < -0.5 ? height / Math.tan(radians(-unit.pitchDeg)) : FARTHEST_AIM_CM;
  const distance = Math.min(Math.max(reach, NEAREST_AIM_CM), FARTHEST_AIM_CM);
  const yaw = radians(unit.yawDeg);
  return [unit.place[0] + distance * Math.cos(yaw), unit.place[1] + distance * Math.sin(yaw)];
}

// The direction and tilt that look from a place and height to a point of the road.
export function aimAt(place, heightM, point) {
  const [dx, dy] = [point[0] - place[0], point[1] - place[1]];
  return { yaw: degrees(Math.atan2(dy, dx)), pitch: -degrees(Math.atan2(100 * heightM, Math.hypot(dx, dy))) };
}

// Ground that a sensor could see if nothing stood there, as a path in centimetres: while it is turned.
export function openView(unit, reachM = FREE_REACH_M) {
  const height = unit.heightM, pitch = radians(unit.pitchDeg);
  const ahead = []; // metres along and to the left of where it looks, around the edge of what it sees
  const add = (along, left, up) => {
    const level = Math.hypot(along, left) || 1e-9;
    const share = up < 0 ? Math.min(height / -up, reachM / level) : reachM / level;
    ahead.push([along * share, left * share]);
  };
  const steps = Array.from({ length: 13 }, (_, step) => step / 6 - 1);
  if (unit.kind === "camera") {
    const [wide, high] = [unit.fovDeg, unit.verticalFovDeg].map((angle) => Math.tan(radians(Math.min(angle, 172)) / 2)); // nothing is seen farther out
    const ray = (left, up) => add(Math.cos(pitch) - up * high * Math.sin(pitch), left * wide, Math.sin(pitch) + up * high * Math.cos(pitch));
    steps.forEach((step) => ray(step, 1));
    steps.forEach((step) => ray(1, -step));
    steps.forEach((step) => ray(-step, -1));
    steps.forEach((step) => ray(-1, step));
  } else {
    const half = radians(Math.min(unit.fovDeg, 359.9)) / 2;
    for (const edge of [1, -1]) {
      const tilt = pitch + edge * radians(unit.verticalFovDeg) / 2;
      steps.forEach((step) => add(Math.cos(edge * step * half), Math.sin(edge * step * half), Math.tan(Math.max(tilt, -1.57))));
    }
  }
  const [cos, sin] = [Math.cos(radians(unit.yawDeg)), Math.sin(radians(unit.yawDeg))];
  return "M" + ahead.map(([along, left]) => `${Math.round(unit.place[0] + 100 * (along * cos - left * sin))} ${Math.round(unit.place[1] + 100 * (along * sin + left * cos))}`).join("L") + "Z";
}

// The end of a way, before the place of the impact.
function lastOf(way) {
  const [x, y] = way.at(-1);
  const first = way.findIndex((place) => Math.hypot(place[0] - x, place[1] - y) <= ARM_CM);
  return way.slice(Math.max(0, Math.min(first, way.length - 2)));
}

// From lost to avoided by way of a light grey.
function shareColour(share) {
  const [from, to, part] = share < 0.5 ? [LOST_RGB, MIDDLE_RGB, 2 * share] : [MIDDLE_RGB, AVOIDED_RGB, 2 * share - 1];
  return `rgb(${from.map((value, index) => Math.round(value + (to[index] - value) * part)).join(" ")})`;
}

function pie(share, radius) {
  if (share >= 0.9999) return `M${radius} 0A${radius} ${radius} 0 1 1 ${-radius} 0A${radius} ${radius} 0 1 1 ${radius} 0Z`;
  const angle = 2 * Math.PI * share;
  const [x, y] = [radius * Math.sin(angle), -radius * Math.cos(angle)];
  return `M0 0V${-radius}A${radius} ${radius} 0 ${share > 0.5 ? 1 : 0} 1 ${x.toFixed(2)} ${y.toFixed(2)}Z`;
}

// Private ground: lines that are seen in grey, too.
function addHatching(svg) {
  const hatched = element("pattern", { id: "private-fill", width: 120, height: 120, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" }, element("defs", {}, svg));
  element("rect", { width: 120, height: 120, fill: "#fff", "fill-opacity": 0.55 }, hatched);
  element("path", { d: "M0 0V120", stroke: "#5a1a5e", "stroke-width": 44 }, hatched);
}

export function createMap(holder, on) {
  const svg = element("svg", { role: "group", "aria-label": tr("Plan: poles and sensors") }, holder);
  addPatterns(svg);
  addHatching(svg);
  const ground = element("g", { "stroke-linejoin": "round" }, svg);
  const layers = Object.fromEntries(["still", "tiles", "image", "coverage", "private", "ways", "views", "danger", "chosen", "seen", "offered", "run"].map((name) => [name, element("g", {}, ground)]));
  layers.danger.setAttribute("pointer-events", "none");
  const marks = element("g", {}, svg);
  const marked = Object.fromEntries(["arms", "names", "other", "run", "sites", "units", "aim", "drag", "ruler", "scale"].map((name) => [name, element("g", {}, marks)]));
  marked.scale.setAttribute("font-size", 11);
  let scene = null, units = [], selected = null, chosenSite = null;
  let middle = [0, 0], half = 5000, width = 600, height = 400, perCm = 0.05, origin = [0, 0];
  let drawn = new Map(), placed = [], others = [], handle = null, pickPoint = null, views = new Map(), ruler = null, isPoling = false, laidOut = () => {};
  const at = ([x, y]) => [origin[0] + x * perCm, origin[1] - y * perCm];
  const put = (mark, place) => { const [x, y] = at(place); mark.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`); };
  const placeOf = ([x, y]) => {
    const box = svg.getBoundingClientRect();
    return [(x - box.left - origin[0]) / perCm, (origin[1] - (y - box.top)) / perCm];
  };
  const groundOf = (event) => placeOf([event.clientX, event.clientY]);
  const run = createRunDrawing({ ground: layers.run, marks: marked.run, at, put });

  function layOut() {
    [width, height] = [Math.max(holder.clientWidth, 200), Math.max(holder.clientHeight, 200)];
    for (const [name, value] of Object.entries({ width, height, viewBox: `0 0 ${width} ${height}` })) svg.setAttribute(name, value);
    perCm = 0.5 * Math.min(width, height) / half;
    origin = [0.5 * width - middle[0] * perCm, 0.5 * height + middle[1] * perCm];
    ground.setAttribute("transform", `matrix(${perCm} 0 0 ${-perCm} ${origin[0]} ${origin[1]})`);
    [...placed, ...others, ...drawn.values()].forEach(({ mark, place }) => put(mark, place));
    putHandle();
    drawRuler();
    run.layOut();
    drawScale(marked.scale, width, height, perCm);
    laidOut();
  }

  function zoomBy(factor, point = middle) {
    const next = Math.min(Math.max(half / factor, 200), 60000);
    const share = next / half;
    middle = middle.map((value, axis) => point[axis] + (value - point[axis]) * share);
    half = next;
    layOut();
  }

  // Bring the ground at one place to another.
  function shift(from, to) {
    middle = middle.map((value, axis) => value + from[axis] - to[axis]);
    layOut();
  }

  // The window that holds the junction and every place of an impact.
  function whole() {
    middle = [...scene.plan.middle];
    const away = scene.arms.map((arm) => Math.max(Math.abs(arm.place[0] - middle[0]), Math.abs(arm.place[1] - middle[1])));
    half = Math.max(scene.plan.half, ...away.map((reach) => Math.min(1.12 * reach, 1.8 * scene.plan.half)));
    layOut();
  }

  // ---------- what stands still

  function showScene(next) {
    scene = next;
    views = new Map();
    whole();
    for (const layer of ["still", "coverage", "private", "ways", "seen"]) layers[layer].replaceChildren();
    for (const layer of ["arms", "names", "sites"]) marked[layer].replaceChildren();
    placed = [];
    drawGround(layers.still, scene.plan);
    scene.private.forEach((area) => element("title", { text: tr("private: {name}", area) }, element("path", { d: area.path, "fill-rule": "evenodd", fill: "url(#private-fill)", stroke: "#3d0f40", "stroke-width": 1.6, ...THIN }, layers.private)));
    const along = (places) => "M" + places.map((place) => place.join(" ")).join("L");
    scene.arms.forEach((arm) => element("path", { d: along(arm.way), fill: "none", stroke: "#6b6b6b", "stroke-width": 1, "stroke-dasharray": "5 4", ...THIN }, layers.ways));
    scene.arms.forEach((arm) => element("path", { d: along(lastOf(arm.way)), fill: "none", stroke: "none", "stroke-width": 5, "stroke-opacity": 0.75, class: "share", ...THIN }, layers.ways));
    scene.plan.arms.forEach((arm) => placed.push({ place: arm.place, mark: element("text", { text: arm.name, "font-size": 13, "text-anchor": "middle", "paint-order": "stroke", stroke: "#fff", "stroke-width": 3, fill: "#333" }, marked.names) }));
    scene.arms.forEach((arm) => placed.push({ place: arm.place, arm, mark: element("g", { class: "arm" }, marked.arms) }));
    showSites(scene.sites);
    showSite(null);
  }

  // Poles: the scene's, and those of one's own, which are square.
  function showSites(sites) {
    const focused = document.activeElement?.closest?.("[data-site]")?.dataset.site;
    scene.sites = sites;
    placed = placed.filter((item) => !item.site);
    marked.sites.replaceChildren();
    scene.sites.forEach((site) => {
      const mark = element("g", { class: "site", tabindex: 0, role: "button", "data-site": site.id }, marked.sites);
      element("circle", { r: 14, fill: "transparent" }, mark);
      const drawn_ = { fill: site.isForbidden ? "#bbb" : "#fff", stroke: "#222", "stroke-width": 1.6, class: "dot" };
      if (site.isOwn) element("rect", { x: -5, y: -5, width: 10, height: 10, ...drawn_ }, mark);
      else element("circle", { r: 5, ...drawn_ }, mark);
      const said = site.isForbidden ? tr("{id}: {kind}, forbidden", site) : site.isOwn ? tr("{id}: your own, {kind}, carries {capacity}", site) : tr("{id}: {kind}, carries {capacity}", site);
      element("title", { text: said }, mark);
      mark.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); if (ruler) rule(site.place); else on.site(site.id); } });
      placed.push({ place: site.place, site, mark });
    });
    layOut();
    showSite(chosenSite);
    if (focused) marked.sites.querySelector(`[data-site="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
  }

  function showShares(shares) {
    layers.ways.querySelectorAll(".share").forEach((path, index) => path.setAttribute("stroke", typeof shares?.[index] === "number" ? shareColour(shares[index]) : "none"));
    placed.filter((item) => item.arm).forEach((item, index) => {
      item.mark.replaceChildren();
      const share = shares ? shares[index] : null;
      element("circle", { r: 7, fill: share === null || share === undefined ? "#ddd" : LOST_COLOUR, stroke: "#222", "stroke-width": 1 }, item.mark);
      if (share) element("path", { d: pie(share, 7), fill: AVOIDED_COLOUR }, item.mark);
      const said = share === null || share === undefined ? tr("not known yet") : tr("{share} % avoided", { share: number(100 * share, 0) });
      element("title", { text: tr("from the {approach}, at {position} m: {said}", { ...item.arm, said }) }, item.mark);
    });
  }

  function showSeen(places) {
    layers.seen.replaceChildren();
    const [low, side] = [-SEEN_CM / 2, SEEN_CM];
    const d = places.map(([x, y]) => `M${x + low} ${y + low}h${side}v${side}h${-side}Z`).join("");
    if (d) element("path", { d, fill: "#CC0000", stroke: "#fff", "stroke-width": 1, class: "seen", ...THIN }, layers.seen);
  }

  function showCoverage(found) {
    layers.coverage.replaceChildren();
    if (!found) return;
    const [bands, road] = [atob(found.band), atob(found.road)];
    const [west, south, east, north] = found.box;
    const columns = found.columns, rows = bands.length / columns;
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [columns, rows];
    const context = canvas.getContext("2d");
    for (let row = 0; row < rows; row += 1) for (let column = 0; column < columns; column += 1) {
      const cell = row * columns + column;
      if (!road.charCodeAt(cell)) continue;
      const band = bands.charCodeAt(cell);
      context.fillStyle = bandColour(band);
      context.fillRect(column, rows - 1 - row, 1, 1);
    }
    element("image", { href: canvas.toDataURL(), x: 0, y: 0, width: 1, height: 1, opacity: 0.8, preserveAspectRatio: "none", "image-rendering": "pixelated", transform: `matrix(${east - west} 0 0 ${south - north} ${west} ${north})` }, layers.coverage);
  }

  // Number of a cell of a grid at a place; -1: outside.
  function cellAt(found, [x, y]) {
    const [west, south, east, north] = found.box;
    const columns = found.columns, rows = found.errors[0].length / columns;
    const column = Math.floor((x - west) / (east - west) * columns);
    const row = Math.floor((y - south) / (north - south) * rows);
    return column >= 0 && column < columns && row >= 0 && row < rows ? row * columns + column : -1;
  }

  let opacity = 0.75;
  function fade(next) {
    opacity = next;
    layers.image.firstChild?.setAttribute("opacity", opacity);
  }
  function showImage(address, size, pairs) {
    layers.image.replaceChildren();
    if (!address) return;
    // A turn, a scale and a shift take (x, -y) of the image to the plan.
    const [[p, a], [q, b]] = pairs;
    const [ux, uy] = [q[0] - p[0], p[1] - q[1]];
    const [vx, vy] = [b[0] - a[0], b[1] - a[1]];
    const square = ux * ux + uy * uy;
    const [cos, sin] = [(ux * vx + uy * vy) / square, (ux * vy - uy * vx) / square];
    const [x, y] = [p[0], -p[1]];
    const shift = [a[0] - (cos * x - sin * y), a[1] - (sin * x + cos * y)];
    element("image", { href: address, width: size[0], height: size[1], opacity, transform: `matrix(${cos} ${sin} ${sin} ${-cos} ${shift[0]} ${shift[1]})` }, layers.image);
  }

  // ---------- mounted sensors

  function showUnits(next) {
    const focused = document.activeElement?.closest?.("[data-unit]")?.dataset.unit;
    units = next;
    layers.views.replaceChildren();
    marked.units.replaceChildren();
    drawn = new Map();
    units.forEach((unit) => {
      const view = element("path", { "fill-rule": "evenodd", fill: unit.colour, stroke: unit.colour, "stroke-dasharray": unit.dash, "data-view": unit.id, ...THIN }, layers.views);
      if (isSeenFrom(unit, views.get(unit.id))) view.setAttribute("d", views.get(unit.id).view);
      const mark = element("g", { class: "unit", tabindex: 0, role: "button", "data-unit": unit.id }, marked.units);
      mark.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); on.unit(unit.id); } });
      drawn.set(unit.id, { place: unit.place, mark, view });
      drawMark(unit);
    });
    drawChosen();
    drawn.forEach(({ mark, place }) => put(mark, place));
    placed.filter((item) => item.site).forEach(({ site, mark }) => {
      const n = units.filter((unit) => unit.site === site.id).length;
      mark.setAttribute("aria-label", tr("Pole {id}, {kind}, {n} of {capacity} units", { ...site, n }));
    });
    if (focused) marked.units.querySelector(`[data-unit="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
    const told = late;
    if (told && addedSince(told)) { late = null; aimAdded(told); }
  }

  function drawMark(unit) {
    const { mark, view } = drawn.get(unit.id), isSelected = unit.id === selected, yaw = radians(unit.yawDeg);
    const faint = Math.min(0.14, 1.2 / Math.max(units.length, 1)), isOld = unit.isLive; // a view of before it was turned
    for (const [name, value] of Object.entries({ "fill-opacity": isSelected ? isOld ? 0.15 : 0.3 : faint, "stroke-width": isSelected && !isOld ? 2.2 : 0.9 })) view.setAttribute(name, value);
    mark.setAttribute("aria-pressed", isSelected);
    mark.setAttribute("aria-label", unit.isLocked ? tr("{unit}, locked", { unit: unit.title }) : unit.title);
    mark.classList.toggle("locked", unit.isLocked);
    mark.replaceChildren();
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)], [x, y] = [(MARK_PX * cos).toFixed(1), (-MARK_PX * sin).toFixed(1)];
    const ahead = element("g", { transform: `translate(${x} ${y})` }, mark);
    element("line", { x2: x, y2: y, stroke: "#000", "stroke-width": 1.6, "pointer-events": "none" }, mark);
    mark.append(ahead);
    element("circle", { r: 12, fill: "transparent" }, ahead);
    element("title", { text: unit.title }, ahead);
    element("path", { d: MARKS[unit.kind], transform: `rotate(${-unit.yawDeg})`, fill: isSelected ? unit.colour : "#fff", stroke: "#000", "stroke-width": isSelected ? 2 : 1.2 }, ahead);
    if (unit.isLocked) element("path", { d: LOCK, class: "lock", transform: "translate(9 9)", fill: "#fff", stroke: "#000", "stroke-width": 1.6 }, ahead);
    if (units.length <= 40) element("text", { text: unit.name, x: 13 * cos, y: -15 * sin + 4, "font-size": 12, "font-weight": 700, "text-anchor": cos > 0.3 ? "start" : cos < -0.3 ? "end" : "middle", "pointer-events": "none", "paint-order": "stroke", stroke: "#fff", "stroke-width": 3 }, ahead);
  }

  // The chosen one's view lies above all others, and so does its ring: it could not be dragged where many are mounted.
  function drawChosen() {
    layers.chosen.replaceChildren();
    marked.aim.replaceChildren();
    handle = null;
    const unit = units.find((item) => item.id === selected);
    if (!unit) return;
    layers.views.append(drawn.get(unit.id).view);
    const aim = aimOf(unit);
    element("path", { d: `M${unit.place.join(" ")}L${aim.join(" ")}`, stroke: "#000", "stroke-width": 1.4, "stroke-dasharray": "2 3", "pointer-events": "none", ...THIN }, layers.chosen);
    if (unit.isLive) element("path", { d: openView(unit, views.get(unit.id)?.reachM), class: "open-view", fill: "none", stroke: unit.colour, "stroke-width": 2, "stroke-dasharray": "6 4", "pointer-events": "none", ...THIN }, layers.chosen);
    if (unit.isLocked) return;
    const mark = element("g", { class: "unit aim", "data-aim": unit.id }, marked.aim);
    element("circle", { r: 16, fill: "transparent" }, mark);
    element("circle", { r: 9, fill: "#fff", "fill-opacity": 0.8, stroke: "#000", "stroke-width": 2 }, mark);
    element("circle", { r: 2.5, fill: "#000" }, mark);
    element("title", { text: tr("drag to turn and tilt; with Shift, turn only") }, mark);
    handle = { unit, aim, mark };
    putHandle();
  }

  // Where the ring is: at the aim, but not upon the pole.
  function handlePlace() {
    const { unit, aim } = handle, least = HANDLE_PX / perCm;
    if (Math.hypot(aim[0] - unit.place[0], aim[1] - unit.place[1]) >= least) return aim;
    const yaw = radians(unit.yawDeg);
    return [unit.place[0] + least * Math.cos(yaw), unit.place[1] + least * Math.sin(yaw)];
  }
  function putHandle() {
    if (handle) put(handle.mark, handlePlace());
  }

  // One unit is turned: all others stay as they are drawn.
  function turn(unit) {
    const index = units.findIndex((item) => item.id === unit.id);
    if (index < 0) return;
    units[index] = unit;
    drawMark(unit);
    if (unit.id === selected) drawChosen();
  }

  // A view that came before the unit was moved elsewhere is not drawn.
  const isSeenFrom = (unit, view) => Boolean(view) && view.place.every((value, axis) => value === unit.place[axis]);

  function showView(view) {
    views.set(view.unit, view);
    const unit = units.find((item) => item.id === view.unit);
    if (unit && isSeenFrom(unit, view)) drawn.get(unit.id).view.setAttribute("d", view.view);
  }

  function showOffered(proposed) {
    layers.offered.replaceChildren();
    (proposed || []).forEach((unit) => {
      element("path", { d: unit.view, "fill-rule": "evenodd", fill: "#CC79A7", "fill-opacity": 0.25, stroke: "#8c3b6b", "stroke-width": 2, "stroke-dasharray": "6 3", ...THIN }, layers.offered);
      element("circle", { cx: unit.place[0], cy: unit.place[1], r: 8 / perCm, fill: "#CC79A7", stroke: "#000", "stroke-width": 1, ...THIN }, layers.offered);
    });
  }

  function showSite(id) {
    chosenSite = id;
    placed.filter((item) => item.site).forEach(({ site, mark }) => mark.querySelector(".dot").setAttribute("stroke-width", site.id === id ? 4 : 1.6));
  }

  // Units of another variant that differ, and where those of this one are in it.
  function showOther(differing) {
    marked.other.replaceChildren();
    others = differing.map(({ place, yawDeg, text }) => {
      const mark = element("g", { class: "other" }, marked.other), yaw = radians(yawDeg);
      const ahead = element("g", { transform: `translate(${(MARK_PX * Math.cos(yaw)).toFixed(1)} ${(-MARK_PX * Math.sin(yaw)).toFixed(1)})` }, mark);
      element("path", { d: MARKS.camera, transform: `rotate(${-yawDeg}) scale(1.3)`, fill: "none", stroke: "#000", "stroke-width": 1.4, "stroke-dasharray": "2 2" }, ahead);
      element("title", { text }, ahead);
      return { place, mark };
    });
    others.forEach(({ mark, place }) => put(mark, place));
  }

  // ---------- the ruler

  // Two presses, or a drag; poles are met exactly.
  const ruled = (event) => nearestSite(event, SNAP_PX)?.place ?? groundOf(event);
  function drawRuler() {
    marked.ruler.replaceChildren();
    if (!ruler?.from) return;
    const [[x1, y1], [x2, y2]] = [at(ruler.from), at(ruler.to)];
    for (const [stroke, width] of [["#fff", 5], ["#000", 2]]) element("path", { d: `M${x1} ${y1}L${x2} ${y2}`, stroke, "stroke-width": width }, marked.ruler);
    for (const [cx, cy] of [[x1, y1], [x2, y2]]) element("circle", { cx, cy, r: 4, fill: "#fff", stroke: "#000", "stroke-width": 2 }, marked.ruler);
    element("text", { text: `${number(rulerM(), 2)} m`, x: (x1 + x2) / 2, y: (y1 + y2) / 2 - 8, "font-size": 14, "font-weight": 700, "text-anchor": "middle", "paint-order": "stroke", stroke: "#fff", "stroke-width": 4 }, marked.ruler);
  }
  const rulerM = () => Math.hypot(ruler.to[0] - ruler.from[0], ruler.to[1] - ruler.from[1]) / 100;
  function rule(place) {
    if (ruler.isOpen) Object.assign(ruler, { to: place, isOpen: false });
    else ruler = { from: place, to: place, isOpen: true };
    drawRuler();
    if (!ruler.isOpen) on.measured(rulerM());
  }
  function measure(isOn) {
    if (isOn && isPoling) pole(false);
    ruler = isOn ? {} : null;
    svg.classList.toggle("measuring", isOn);
    drawRuler();
    on.measuring(isOn);
  }

  // Poles of one's own: a press puts one, a drag moves it.
  function pole(isOn) {
    if (isOn && ruler) measure(false);
    isPoling = isOn;
    svg.classList.toggle("measuring", isOn);
    on.poling(isOn);
  }

  // ---------- the pointer

  let drag = null, late = null; // `late`: a drag that ended before its sensor was told
  const pointers = new Map();

  function nearestSite(event, reach = SITE_REACH_PX) {
    const box = svg.getBoundingClientRect();
    const here = [event.clientX - box.left, event.clientY - box.top];
    const near = scene.sites.map((site) => { const [x, y] = at(site.place); return { site, away: Math.hypot(x - here[0], y - here[1]) }; }).sort((a, b) => a.away - b.away)[0];
    return near && near.away <= reach ? near.site : null;
  }

  // Escape, or a second finger: what was begun is as if it had not been.
  function giveUp() {
    const given = drag;
    drag = null;
    marked.drag.replaceChildren();
    if (given?.kind === "pan") { middle = given.middle; layOut(); }
    if (given?.kind === "aim" && given.isMoved) on.giveUp(given.unit, given.gesture);
    if (given?.before) { late = null; on.giveUp(null, given.gesture); }
    if (given?.kind === "ruler" || ruler?.isOpen) { ruler = {}; drawRuler(); return true; }
    if (given || pickPoint) { pickPoint = null; return true; }
    if (ruler) { measure(false); return true; }
    if (isPoling) { pole(false); return true; }
    return false;
  }

  function begin(event) {
    if (!scene || (event.pointerType === "mouse" && event.button !== 0)) return;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size > 2) return;
    if (pointers.size === 2) { giveUp(); drag = { kind: "pinch", ground: placeOf(between()), spread: spread() }; return; }
    const [aim, unit, site] = ["aim", "unit", "site"].map((name) => event.target.closest(`[data-${name}]`)?.dataset[name]);
    drag = { from: [event.clientX, event.clientY], start: groundOf(event), middle: [...middle], isMoved: false, gesture: `${Date.now()}-${Math.random()}` };
    if (pickPoint) drag.kind = "pick";
    else if (ruler) Object.assign(drag, { kind: "ruler", wasOpen: ruler.isOpen });
    else if (isPoling) Object.assign(drag, nearestSite(event) ? { kind: "pole", site: nearestSite(event) } : { kind: "pan" });
    else if (aim) Object.assign(drag, { kind: "aim", unit: aim, off: handle.aim.map((value, axis) => value - drag.start[axis]) });
    else if (unit) { Object.assign(drag, { kind: "unit", unit }); on.unit(unit); }
    else if (site) Object.assign(drag, { kind: "site", site: nearestSite(event) }); // marks overlap: not the upper one
    else drag.kind = "pan";
    if (drag.kind === "ruler" && !ruler.isOpen) rule(ruled(event));
    svg.setPointerCapture(event.pointerId);
  }

  const between = () => { const [a, b] = [...pointers.values()]; return [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]; };
  const spread = () => { const [a, b] = [...pointers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };

  function line(from, to) {
    marked.drag.replaceChildren();
    const [[x1, y1], [x2, y2]] = [at(from), at(to)];
    element("line", { x1, y1, x2, y2, stroke: "#000", "stroke-width": 2, "stroke-dasharray": "4 3" }, marked.drag);
    element("circle", { cx: x2, cy: y2, r: 9, fill: "none", stroke: "#000", "stroke-width": 2 }, marked.drag);
  }

  function aimed(event) {
    const unit = units.find((item) => item.id === drag.unit);
    if (!unit) return null;
    const aim = aimAt(unit.place, unit.heightM, groundOf(event).map((value, axis) => value + drag.off[axis]));
    aim.yaw = on.snapped(aim.yaw);
    return event.shiftKey || unit.isRing ? { yaw: aim.yaw } : aim;
  }

  const addedSince = (since) => units.find((unit) => !since.before.includes(unit.id));

  function aimAdded(since) {
    const added = addedSince(since);
    if (added) on.aim(added.id, added.isRing ? { yaw: since.aim.yaw } : since.aim, since.gesture);
  }

  // A new sensor is mounted when its drag begins, so that its number follows.
  function aimNew(event) {
    if (!drag.site.isForbidden) line(drag.site.place, groundOf(event));
    drag.aim = aimAt(drag.site.place, on.heightOf(drag.site), groundOf(event));
    drag.aim.yaw = on.snapped(drag.aim.yaw);
    if (drag.before) return aimAdded(drag);
    drag.before = units.map((unit) => unit.id);
    on.hang(drag.site.id, drag.aim, drag.gesture);
  }

  function move(event) {
    if (!drag && ruler?.isOpen) { ruler.to = ruled(event); drawRuler(); }
    if (!drag || !pointers.has(event.pointerId)) return;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (drag.kind === "pinch") {
      const now = spread();
      zoomBy(now / drag.spread);
      drag.spread = now;
      shift(drag.ground, placeOf(between())); // the ground between the fingers stays there
      return;
    }
    const [dx, dy] = [event.clientX - drag.from[0], event.clientY - drag.from[1]];
    if (!drag.isMoved && Math.hypot(dx, dy) < DRAG_PX) return;
    drag.isMoved = true;
    if (drag.kind === "ruler") { ruler.to = ruled(event); drawRuler(); }
    else if (drag.kind === "pan") {
      middle = [drag.middle[0] - dx / perCm, drag.middle[1] + dy / perCm];
      layOut();
    } else if (drag.kind === "aim") {
      const aim = aimed(event);
      if (aim) on.aim(drag.unit, aim, drag.gesture);
    } else if (drag.kind === "pole" && drag.site.isOwn) line(drag.site.place, groundOf(event));
    else if (drag.kind === "site") aimNew(event);
    else if (drag.kind === "unit") {
      const unit = units.find((item) => item.id === drag.unit);
      const site = nearestSite(event);
      if (unit?.isLocked) { on.refused(unit.id); drag = null; }
      else if (unit) line(unit.place, site ? site.place : groundOf(event));
    }
  }

  function end(event) {
    pointers.delete(event.pointerId);
    const done = drag;
    drag = null;
    marked.drag.replaceChildren();
    if (!done || done.kind === "pinch" || event.type === "pointercancel") return;
    if (done.kind === "pick") { const pick = pickPoint; pickPoint = null; pick(groundOf(event)); return; }
    if (done.kind === "ruler") { if (done.isMoved || done.wasOpen) rule(ruled(event)); return; }
    if (isPoling && done.kind === "pan" && !done.isMoved) { on.putPole(groundOf(event)); return; }
    if (done.kind === "pole") {
      if (done.isMoved && done.site.isOwn) on.putPole(groundOf(event), done.site.id);
      else on.unit(null);
      on.site(done.site.id);
      return;
    }
    if (done.kind === "pan" && !done.isMoved) { on.unit(viewUnder(event)); return; }
    if (done.kind === "site") {
      if (!done.isMoved) on.site(done.site.id);
      else if (!addedSince(done)) late = done; // it is aimed when it is told
    } else if (done.kind === "unit" && done.isMoved) {
      const site = nearestSite(event);
      if (site) { on.move(done.unit, site.id); on.site(site.id); }
    }
  }

  // Of the views at a place the next one after the chosen one; null: there is none.
  function viewUnder(event) {
    const under = document.elementsFromPoint(event.clientX, event.clientY).map((one) => one.dataset?.view);
    const ids = units.map((unit) => unit.id).filter((id) => under.includes(id));
    return ids.length ? ids[(ids.indexOf(selected) + 1) % ids.length] : null;
  }

  // A notch of a wheel zooms, and so does a pinch (which browsers tell as a wheel with Ctrl); two fingers of a trackpad pan.
  let lastWheel = { at: -Infinity, isNotch: false };
  function wheel(event) {
    const mode = event.deltaMode; // before the deltas: else Firefox tells lines as pixels
    const now = performance.now(), isAcross = event.shiftKey && event.deltaX === 0;
    const [dx, dy] = isAcross ? [event.deltaY, 0] : [event.deltaX, event.deltaY];
    const isFirst = now - lastWheel.at > STREAM_MS;
    const isNotch = isFirst ? mode !== 0 || (dx === 0 && Math.abs(dy) >= NOTCH_PX) : lastWheel.isNotch;
    lastWheel = { at: now, isNotch };
    const within = (value) => Math.min(Math.max(value, -1), 1);
    if (event.ctrlKey || event.metaKey) zoomBy(WHEEL_STEP ** -within(mode ? dy : dy / PINCH_PX), groundOf(event));
    else if (isNotch && Math.abs(dy) >= Math.abs(dx)) zoomBy(WHEEL_STEP ** -within(mode ? dy : dy / NOTCH_PX), groundOf(event));
    else shift([(mode ? 40 : 1) * dx / perCm, -(mode ? 40 : 1) * dy / perCm], [0, 0]);
  }

  svg.addEventListener("pointerdown", begin);
  svg.addEventListener("pointermove", move);
  svg.addEventListener("pointermove", (event) => on.hover(groundOf(event)));
  svg.addEventListener("pointerleave", () => on.hover(null));
  svg.addEventListener("pointerup", end);
  svg.addEventListener("pointercancel", end);
  svg.addEventListener("wheel", (event) => { event.preventDefault(); wheel(event); }, { passive: false });
  new ResizeObserver(layOut).observe(holder);

  return {
    showScene, showShares, showSeen, showCoverage, cellAt, showDanger: (points) => drawDanger(layers.danger, points), showImage, showUnits, showView, showOffered, showOther, showSite, showSites, fade, turn, zoomBy, giveUp, forgetLate: () => { late = null; }, measure, pole, run,
    isMeasuring: () => Boolean(ruler),
    isPoling: () => isPoling,
    select(id) { selected = id; showUnits(units); },
    whole,
    pick(then) { pickPoint = then; },
    viewOf: (id) => views.get(id),
    layer: (name) => layers[name],
    watch(then) { laidOut = then; }, // told when the window has changed
    window: () => ({ west: -origin[0] / perCm, east: (width - origin[0]) / perCm, south: (origin[1] - height) / perCm, north: origin[1] / perCm, perCm }),
  };
}
