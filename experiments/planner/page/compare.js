// Another variant beside the one that is worked on: units that differ, and cases by points.

import { ask } from "./line.js";
import { element } from "./shared.js";
import { number, tr } from "./words.js";

const find = (id) => document.getElementById(id);
const REST_MS = 250; // after a change, before it is compared again
const NEAR_M = 0.05, LEAST_DEG = 0.05;
const wrapped = (deg) => 180 - ((((180 - deg) % 360) + 360) % 360);
const signed = (value, digits) => `${value > 0 ? "+" : value < 0 ? "\u2212" : "\u00b1"}${number(Math.abs(value), digits)}`;
const shareOf = (text) => Number.parseFloat(`${text}`.replace(",", ".")); // "81.3 %", or "81,3 %"

// Units of two variants as a plan's file has them: pairs by name, then by place; those left over.
export function differences(here, there) {
  const left = [...there], pairs = [], added = [];
  const taken = (index) => left.splice(index, 1)[0];
  const isAt = (a, b) => Math.hypot(a.x_m - b.x_m, a.y_m - b.y_m, a.z_m - b.z_m) < NEAR_M;
  const rest = here.filter((unit) => {
    const index = left.findIndex((other) => other.id === unit.id);
    if (index >= 0) pairs.push([unit, taken(index)]);
    return index < 0;
  });
  rest.forEach((unit) => {
    const index = left.findIndex((other) => isAt(unit, other));
    if (index >= 0) pairs.push([unit, taken(index)]);
    else added.push(unit);
  });
  const changed = pairs.map(([unit, other]) => ({ unit, other, words: changesOf(unit, other) })).filter((pair) => pair.words.length);
  return { added, removed: left, changed };
}

function changesOf(unit, other) {
  const words = [], turned = wrapped(unit.yaw_deg - other.yaw_deg), tilted = (unit.pitch_deg ?? 0) - (other.pitch_deg ?? 0), raised = unit.z_m - other.z_m;
  const awayM = Math.hypot(unit.x_m - other.x_m, unit.y_m - other.y_m);
  if (unit.site !== other.site) words.push(tr("moved from {before} to {after}", { before: other.site || tr("no pole"), after: unit.site || tr("no pole") }));
  else if (awayM > NEAR_M) words.push(tr("moved by {distance} m", { distance: number(awayM, 2) }));
  if (Math.abs(turned) > LEAST_DEG) {
    const angle = number(Math.abs(turned), 1);
    words.push(turned < 0 ? tr("turned by {angle}\u00b0 clockwise", { angle }) : tr("turned by {angle}\u00b0 counterclockwise", { angle }));
  }
  if (Math.abs(tilted) > LEAST_DEG) {
    const angle = number(Math.abs(tilted), 1);
    words.push(tilted > 0 ? tr("tilted {angle}\u00b0 up", { angle }) : tr("tilted {angle}\u00b0 down", { angle }));
  }
  if (Math.abs(raised) > NEAR_M && unit.site === other.site) {
    const distance = number(Math.abs(raised), 2);
    words.push(raised > 0 ? tr("{distance} m higher", { distance }) : tr("{distance} m lower", { distance }));
  }
  const model = (one) => JSON.stringify([one.camera, one.lidar, one.fov_deg, one.horizontal_fov_deg]);
  if (model(unit) !== model(other)) words.push(tr("another model or lens"));
  return words;
}

export function compareVariants({ map, state, cases }) {
  const select = find("compare");
  let rows = [], chosen = "", timer = 0, turn = 0;

  function fillChoice() {
    const names = state().variants.map((variant) => variant.name), others = names.filter((_, index) => index !== state().current);
    if (!others.includes(chosen)) chosen = "";
    const wanted = JSON.stringify(others);
    if (select.dataset.names !== wanted) {
      select.dataset.names = wanted;
      select.replaceChildren(...["", ...others].map((name) => element("option", { value: name, text: name || tr("nothing") })));
    }
    select.value = chosen;
    find("compare-row").hidden = others.length === 0;
  }

  // Layouts are in the plan's file: it is asked for once the plan rests.
  async function compare() {
    const mine = state().variants[state().current]?.name, asked = (turn += 1);
    find("compare-result").hidden = !chosen;
    if (!chosen) { map.showOther([]); return; }
    let plan;
    try {
      plan = await ask("plan.json");
    } catch (error) {
      if (asked === turn) find("compare-units").replaceChildren(element("li", { text: error.message }));
      return;
    }
    if (asked !== turn) return;
    const layoutOf = (name) => plan.variants.find((variant) => variant.name === name)?.layout ?? [];
    show(mine, differences(layoutOf(mine), layoutOf(chosen)));
  }

  function show(mine, { added, removed, changed }) {
    find("compare-title").textContent = tr("{one} against {other}", { one: mine, other: chosen });
    const said = [
      ...added.map(({ id, site }) => (site ? tr("{id}: only here, at {site}", { id, site }) : tr("{id}: only here", { id }))),
      ...removed.map(({ id, site }) => (site ? tr("{id}: only in {variant}, at {site}", { id, site, variant: chosen }) : tr("{id}: only in {variant}", { id, variant: chosen }))),
      ...changed.map(({ unit, other, words }) => `${unit.id === other.id ? unit.id : tr("{id} (there {other})", { id: unit.id, other: other.id })}: ${words.join(", ")}`),
    ];
    find("compare-units").replaceChildren(...(said.length ? said : [tr("The same units with the same aims.")]).map((text) => element("li", { text })));
    map.showOther([...removed, ...changed.map(({ other }) => other)].map((unit) => ({ place: [100 * unit.x_m, 100 * unit.y_m], yawDeg: unit.yaw_deg, text: tr("{id} in {variant}", { id: unit.id, variant: chosen }) })));
    showPoints(mine);
  }

  // By the shares that the table shows, so that whoever subtracts them finds the same.
  function showPoints(mine) {
    const [here, there] = [mine, chosen].map((name) => rows.find((row) => row.name === name));
    const [body] = find("compare-points").tBodies;
    body.replaceChildren();
    const isKnown = here && there && here.source !== "none" && there.source !== "none";
    const isSameSource = isKnown && here.source === there.source;
    find("compare-note").textContent = !isKnown ? tr("Numbers appear when both are computed.") : isSameSource ? "" : tr("One is from the detection table, the other from the evaluator: they cannot be compared yet.");
    if (!isSameSource) return;
    const names = [...new Set([...Object.keys(here.byCase), ...Object.keys(there.byCase)])];
    const lines = [["APR", here.apr, there.apr], [tr("APR if one fails"), here.oneFails, there.oneFails], ...names.map((name) => [name, here.byCase[name], there.byCase[name]])];
    for (const [name, a, b] of lines) {
      const [x, y] = [shareOf(a), shareOf(b)];
      if (!Number.isFinite(x) || !Number.isFinite(y)) continue;
      const row = element("tr", {}, body);
      element("th", { scope: "row", text: name, title: cases()[name] ?? "" }, row);
      for (const text of [a, b, tr("{n} points", { n: signed(x - y, 1) })]) element("td", { class: "number", text }, row);
    }
    find("compare-points").tHead.rows[0].replaceChildren(...["", mine, chosen, tr("difference")].map((text) => element("th", { scope: "col", text })));
  }

  select.addEventListener("change", () => { chosen = select.value; compare(); });
  return {
    stateChanged() {
      fillChoice();
      clearTimeout(timer);
      if (chosen) timer = setTimeout(compare, REST_MS);
      else compare();
    },
    variantsChanged(next) {
      rows = next;
      const mine = state()?.variants[state().current]?.name;
      if (chosen && mine) showPoints(mine);
    },
  };
}
