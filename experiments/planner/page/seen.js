// The picture of the chosen camera: with rough edges while it is turned, smooth when it stands.

import { ask } from "./line.js";
import { element, seconds } from "./shared.js";
import { tr } from "./words.js";

const find = (id) => document.getElementById(id);
const WIDTH_PX = 640, STANDS_MS = 300, AGAIN_MS = 200;

// `unitNow` is the chosen unit as the session has told it, `runNow` the run and frame that are played.
export function createSeen({ unitNow, runNow, scene }) {
  const holder = find("seen"), image = find("seen-image"), frame = find("seen-frame");
  let shown = { key: "" }, wanted = "", changedAt = 0, isBusy = false, timer = 0;

  const keyOf = (unit, run) => JSON.stringify([unit.id, unit.place, unit.yawDeg, unit.pitchDeg, unit.heightM, unit.fovDeg, unit.sensor, run]);

  // Something may be another: the unit, its pose, the run or its time.
  function changed() {
    const unit = unitNow();
    holder.hidden = !unit;
    if (!unit || !holder.open) return;
    const isCamera = unit.kind === "camera";
    frame.hidden = !isCamera;
    if (!isCamera) { shown = { key: "" }; say(tr("A LiDAR takes no picture.")); return; }
    const key = keyOf(unit, runNow());
    if (key !== wanted) { wanted = key; changedAt = performance.now(); }
    if (key !== shown.key) holder.setAttribute("aria-busy", "true");
    if (key !== shown.key && !image.src) say(tr("Drawing \u2026"));
    next();
  }

  const say = (text) => { if (find("seen-text").textContent !== text) find("seen-text").textContent = text; };

  // One at a time; what changed meanwhile is asked for when it is here.
  async function next() {
    clearTimeout(timer);
    const unit = unitNow();
    if (isBusy || !unit || unit.kind !== "camera" || !holder.open) return;
    const stoodMs = performance.now() - changedAt;
    const smooth = stoodMs < STANDS_MS ? 0 : 1;
    if (shown.key === wanted && shown.smooth >= smooth) {
      if (!shown.smooth) timer = setTimeout(next, STANDS_MS - stoodMs + 1);
      return;
    }
    const key = wanted, run = runNow();
    isBusy = true;
    let pauseMs = 0;
    try {
      const found = await ask("seen", { unit: unit.id, width: WIDTH_PX, smooth, ...(run ?? {}) });
      if (found.problem) throw new Error(found.problem);
      if (unitNow()?.id === unit.id) show(unit, found, key === wanted, { key, smooth });
    } catch (error) {
      pauseMs = AGAIN_MS; // another page was first, the unit is gone, or the line is lost
      if (unitNow()?.id === unit.id && error.message !== tr("it was stopped")) { say(error.message); shown = { key, smooth: 1 }; }
    } finally {
      isBusy = false;
    }
    timer = setTimeout(next, pauseMs);
  }

  function show(unit, found, isNewest, now) {
    shown = now;
    const [width, height] = found.size;
    image.src = `data:image/jpeg;base64,${found.image}`;
    const run = scene().runs.find((one) => one.id === found.run);
    if (!run) return; // of a question that is none any longer
    const told = { run: run.title, time: seconds(Math.abs(1000 * found.timeS), 1) };
    const what = found.timeS === 0 ? tr("{run}, at the impact", told) : tr("{run}, {time} s before the impact", told);
    image.alt = tr("What {unit} sees: {what}", { unit: unit.id, what });
    const said = [runNow() ? `${what}.` : tr("{what}: the road user nearest to where the camera looks. Choose a run to see another.", { what })];
    if (!found.box) said.push(tr("The road user is not in the picture."));
    say(said.join(" "));
    image.title = scene().cases[run.title.split(" ")[0]] ?? "";
    frame.style.aspectRatio = `${width} / ${height}`;
    holder.setAttribute("aria-busy", String(!isNewest));
    holder.dataset.smooth = now.smooth;
    const marks = find("seen-box");
    marks.setAttribute("viewBox", "0 0 640 360");
    marks.replaceChildren();
    if (!found.box) return;
    const [left, top, right, bottom] = found.box.map((share, index) => share * (index % 2 ? 360 : 640));
    for (const [stroke, wide] of [["#000", 4], ["#F0E442", 2]]) element("rect", { x: left - 4, y: top - 4, width: right - left + 8, height: bottom - top + 8, fill: "none", stroke, "stroke-width": wide, "vector-effect": "non-scaling-stroke" }, marks);
  }

  holder.addEventListener("toggle", changed);
  return {
    changed,
    again() { shown = { key: "" }; changed(); }, // what it shows is of other times
  };
}
