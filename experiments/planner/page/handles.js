// The chosen sensor from beside and on a compass: drag it up and down, tilt its ray, turn its needle.

import { element } from "./shared.js";
import { number, tr } from "./words.js";

const DIRECTIONS = [tr("north"), tr("north-east"), tr("east"), tr("south-east"), tr("south"), tr("south-west"), tr("west"), tr("north-west")];
const STEP_DEG = 15;
const radians = (deg) => deg * Math.PI / 180;
const degrees = (angle) => angle * 180 / Math.PI;
const within = (value, low, high) => Math.min(Math.max(value, low), high);

// Clockwise from north, 0 .. 360, from a direction counterclockwise from east; and the other way.
export const bearingOf = (yawDeg) => (((90 - yawDeg) % 360) + 360) % 360;

let active = null;

// Escape: a drag on one of these drawings is as if it had not been.
export function giveUpHandle() {
  if (!active) return false;
  const given = active;
  active = null;
  given.giveUp();
  return true;
}

// A drag on a drawing, whose marks are drawn anew meanwhile.
function dragOn(svg, { start, move, giveUp }) {
  svg.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse" && event.button !== 0) return;
    const box = svg.getBoundingClientRect(); // of the whole drag, whatever moves on the page meanwhile
    const begun = start(event, box);
    if (!begun) return;
    event.preventDefault();
    begun.focused?.focus({ preventScroll: true });
    const gesture = `drag ${Date.now()}-${Math.random()}`;
    active = { ...begun, svg, box, gesture, pointer: event.pointerId, giveUp: () => giveUp(begun.unit, gesture) };
    svg.setPointerCapture(event.pointerId);
    move(event, active);
  });
  svg.addEventListener("pointermove", (event) => { if (active?.svg === svg && active.pointer === event.pointerId) move(event, active); });
  for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { if (active?.svg === svg) active = null; });
}

const placeIn = (box, event) => [event.clientX - box.left, event.clientY - box.top];

// ---------- the compass

export function createCompass(holder, on) {
  const SIZE = 124, MIDDLE = SIZE / 2, RADIUS = 44;
  const svg = element("svg", { id: "compass", width: SIZE, height: SIZE, viewBox: `0 0 ${SIZE} ${SIZE}`, role: "slider", tabindex: 0, "aria-label": tr("Compass: bearing"), "aria-valuemin": 0, "aria-valuemax": 359.9 }, holder);
  let unit = null;

  function show(next) {
    unit = next;
    const bearing = bearingOf(unit.yawDeg), where = DIRECTIONS[Math.round(bearing / 45) % 8];
    svg.setAttribute("aria-valuenow", Number(bearing.toFixed(1)));
    svg.setAttribute("aria-valuetext", tr("{angle} degrees, {direction}", { angle: number(bearing, 1), direction: where }));
    svg.setAttribute("aria-disabled", unit.isLocked);
    svg.replaceChildren();
    element("title", { text: tr("drag to turn; with Shift in steps of 15\u00b0") }, svg);
    element("circle", { cx: MIDDLE, cy: MIDDLE, r: RADIUS, fill: "#fff", stroke: "#333", "stroke-width": 1.4 }, svg);
    const at = (deg, radius) => [MIDDLE + radius * Math.sin(radians(deg)), MIDDLE - radius * Math.cos(radians(deg))];
    const half = Math.min(unit.fovDeg, 359.9) / 2, [from, to] = [at(bearing - half, RADIUS), at(bearing + half, RADIUS)];
    element("path", { d: `M${MIDDLE} ${MIDDLE}L${from.join(" ")}A${RADIUS} ${RADIUS} 0 ${half > 90 ? 1 : 0} 1 ${to.join(" ")}Z`, fill: unit.colour, "fill-opacity": 0.3 }, svg);
    for (let deg = 0; deg < 360; deg += STEP_DEG) {
      const [[x1, y1], [x2, y2]] = [at(deg, RADIUS), at(deg, RADIUS - (deg % 90 ? 4 : 8))];
      element("line", { x1, y1, x2, y2, stroke: "#333", "stroke-width": 1 }, svg);
    }
    [tr("N"), tr("E"), tr("S"), tr("W")].forEach((text, index) => { const [x, y] = at(90 * index, RADIUS + 9); element("text", { text, x, y: y + 4, "font-size": 12, "font-weight": 700, "text-anchor": "middle" }, svg); });
    const [x, y] = at(bearing, RADIUS - 6);
    element("line", { x1: MIDDLE, y1: MIDDLE, x2: x, y2: y, stroke: "#000", "stroke-width": 2.4 }, svg);
    element("circle", { cx: MIDDLE, cy: MIDDLE, r: 3, fill: "#000" }, svg);
    element("circle", { cx: x, cy: y, r: 7, fill: "#fff", stroke: "#000", "stroke-width": 2 }, svg);
  }

  dragOn(svg, {
    start: () => { if (unit.isLocked) { on.refused(unit.id); return null; } return { focused: svg, unit: unit.id, isMoved: false }; },
    move(event, drag) {
      const [x, y] = placeIn(drag.box, event).map((value) => value - MIDDLE);
      if (Math.hypot(x, y) < 6) return;
      const yaw = degrees(Math.atan2(-y, x));
      on.turn(drag.unit, event.shiftKey ? STEP_DEG * Math.round(yaw / STEP_DEG) : on.snapped(yaw), drag.gesture);
    },
    giveUp: on.giveUp,
  });
  svg.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: STEP_DEG, PageDown: -STEP_DEG }[event.key];
    if (!step || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    on.key(event.key, "yaw", -step * (event.shiftKey && Math.abs(step) === 1 ? 10 : 1));
  });
  return { show };
}

// ---------- from beside

export function createSideView(holder, on) {
  const HEIGHT = 156, LEFT = 46, BOTTOM = 22, TOP = 8, RAY_PX = 78, MOST_M = 16;
  const svg = element("svg", { id: "side", height: HEIGHT, role: "group", "aria-label": tr("The chosen sensor from beside") }, holder);
  const drawing = element("g", {}, svg);
  let unit = null, reachM = null, topM = 10, scale = 10, width = 300;

  // Grips stay as they are: one that is replaced loses the focus.
  function grip(name, shape, label) {
    const mark = element("g", { class: `grip ${name}`, "data-part": name, tabindex: 0, role: "slider", "aria-label": label, "aria-orientation": "vertical" }, svg);
    element("circle", { r: 16, fill: "transparent" }, mark);
    const sign = shape === "circle" ? element("circle", { r: 8, fill: "#fff", stroke: "#000", "stroke-width": 2 }, mark) : element("rect", { x: -8, y: -7, width: 16, height: 14, stroke: "#000", "stroke-width": 2 }, mark);
    const title = element("title", {}, mark);
    return ([x, y], { now, low, high, said, tip }) => {
      const told = { transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})`, "aria-valuemin": low, "aria-valuemax": high, "aria-valuenow": Number(now.toFixed(2)), "aria-valuetext": said, "aria-disabled": unit.isLocked };
      for (const [key, value] of Object.entries(told)) mark.setAttribute(key, value);
      if (shape === "rect") sign.setAttribute("fill", unit.colour);
      title.textContent = unit.isLocked ? tr("locked") : tip;
    };
  }
  const putTilt = grip("tilt", "circle", tr("Tilt, degrees")), putHeight = grip("height", "rect", tr("Height, metres"));
  const at = ([along, up]) => [LEFT + along * scale, HEIGHT - BOTTOM - up * scale];

  // Where a ray from the sensor leaves the drawing, or meets the road.
  function endOf(deg) {
    const [cos, sin] = [Math.cos(radians(deg)), Math.sin(radians(deg))];
    const limits = [cos > 0 ? ((width - LEFT) / scale) / cos : cos < 0 ? (-LEFT / scale) / cos : Infinity, sin < 0 ? unit.heightM / -sin : sin > 0 ? (topM - unit.heightM + TOP / scale) / sin : Infinity];
    const share = Math.min(...limits);
    return [share * cos, unit.heightM + share * sin];
  }

  const focusedPart = () => document.activeElement?.closest?.("#side [data-part]")?.dataset.part;

  function show(next, reach) {
    unit = next;
    reachM = reach ?? null;
    width = Math.max(holder.clientWidth, 120);
    const [low, high] = unit.heightRange;
    if (active?.svg !== svg) topM = Math.min(high, Math.max(MOST_M, 1.3 * unit.heightM)) + 0.8;
    topM = Math.max(topM, Math.min(unit.heightM + 0.5, high + 0.5));
    scale = (HEIGHT - BOTTOM - TOP) / topM;
    svg.setAttribute("width", width);
    svg.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
    drawing.replaceChildren();
    drawStill(low, Math.min(high, topM));
    drawRays();
  }

  function drawStill(low, high) {
    const road = HEIGHT - BOTTOM;
    element("rect", { x: 0, y: road, width, height: 5, fill: "#bdbdbd" }, drawing);
    element("line", { x1: 0, y1: road, x2: width, y2: road, stroke: "#333", "stroke-width": 1.6 }, drawing);
    const step = [1, 2, 5, 10, 20].find((metres) => metres * scale > 42) || 50;
    for (let metres = 0; LEFT + metres * scale < width - 8; metres += step) element("text", { text: metres ? `${metres}` : "0 m", x: LEFT + metres * scale, y: HEIGHT - 4, "font-size": 11, "text-anchor": "middle" }, drawing);
    for (let metres = step; metres < topM; metres += step) element("text", { text: `${metres} m`, x: 2, y: at([0, metres])[1] + 4, "font-size": 11 }, drawing);
    element("line", { x1: LEFT, y1: road, x2: LEFT, y2: at([0, high])[1], stroke: "#777", "stroke-width": 3 }, drawing);
    element("line", { x1: LEFT, y1: at([0, low])[1], x2: LEFT, y2: at([0, high])[1], stroke: "#222", "stroke-width": 6, "stroke-linecap": "round" }, drawing);
  }

  function drawRays() {
    const eye = at([0, unit.heightM]), half = unit.verticalFovDeg / 2;
    const [lower, upper] = [Math.max(unit.pitchDeg - half, -179), Math.min(unit.pitchDeg + half, 179)];
    const ends = Array.from({ length: 61 }, (_, step) => at(endOf(lower + (upper - lower) * step / 60)));
    element("path", { d: `M${eye.join(" ")}L${ends.map((end) => end.map((value) => value.toFixed(1)).join(" ")).join("L")}Z`, fill: unit.colour, "fill-opacity": 0.25 }, drawing);
    for (const [name, end] of [["lower", ends[0]], ["upper", ends.at(-1)]]) element("path", { d: `M${eye.join(" ")}L${end.join(" ")}`, class: `ray-${name}`, stroke: unit.colour, "stroke-width": 1.8 }, drawing);
    if (reachM && LEFT + reachM * scale < width) element("path", { d: `M${LEFT + reachM * scale} ${HEIGHT - BOTTOM}v-14`, stroke: "#000", "stroke-width": 2 }, drawing);
    const tilt = radians(unit.pitchDeg), knob = [eye[0] + RAY_PX * Math.cos(tilt), within(eye[1] - RAY_PX * Math.sin(tilt), 9, HEIGHT - 9)];
    element("path", { d: `M${eye.join(" ")}L${knob.join(" ")}`, stroke: "#000", "stroke-width": 1.4, "stroke-dasharray": "3 3" }, drawing);
    putTilt(knob, { now: unit.pitchDeg, low: -90, high: 90, said: tr("{angle} degrees", { angle: number(unit.pitchDeg, 1) }), tip: tr("drag to tilt") });
    putHeight(eye, { now: unit.heightM, low: unit.heightRange[0], high: unit.heightRange[1], said: tr("{height} metres", { height: number(unit.heightM, 2) }), tip: tr("drag up or down") });
    element("text", { text: `${number(unit.heightM, 2)} m`, x: eye[0] + 12, y: eye[1] - 10, "font-size": 12, "font-weight": 700, "paint-order": "stroke", stroke: "#fff", "stroke-width": 3 }, drawing);
  }

  dragOn(svg, {
    start(event, box) {
      const name = event.target.closest("[data-part]")?.dataset.part;
      if (!name) return null;
      if (unit.isLocked) { on.refused(unit.id); return null; }
      const [, y] = placeIn(box, event);
      return { name, unit: unit.id, focused: svg.querySelector(`[data-part="${name}"]`), offY: y - at([0, unit.heightM])[1] };
    },
    move(event, drag) {
      const [x, y] = placeIn(drag.box, event), eye = at([0, unit.heightM]);
      if (drag.name === "height") {
        const height = within((HEIGHT - BOTTOM - (y - drag.offY)) / scale, ...unit.heightRange);
        on.raise(drag.unit, within(Math.round(height * 20) / 20, ...unit.heightRange), drag.gesture);
      } else if (Math.hypot(x - eye[0], y - eye[1]) > 4) {
        on.tilt(drag.unit, within(degrees(Math.atan2(eye[1] - y, Math.max(x - eye[0], 0))), -90, 90), drag.gesture);
      }
    },
    giveUp: on.giveUp,
  });
  svg.addEventListener("keydown", (event) => {
    const name = focusedPart(), sign = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1 }[event.key];
    if (!name || !sign || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    on.key(event.key, name, sign * (name === "height" ? 0.25 : event.shiftKey ? 10 : 1));
  });
  new ResizeObserver(() => { if (unit && holder.clientWidth && holder.clientWidth !== width) show(unit, reachM); }).observe(holder);
  return { show };
}
