// Tiles of the server that --tiles names, behind the plan: squares of Web Mercator in the plan's own frame.

import { element } from "./shared.js";
import { tr } from "./words.js";

const find = (id) => document.getElementById(id);
const TILE_PX = 256, DEEPEST = 19, MOST = 120;

// Powers of two numbers up to the third, in the order of the server's fit.
const powers = (u, v) => [1, u, v, u * u, u * v, v * v, u ** 3, u * u * v, u * v * v, v ** 3];
const sums = (fit, u, v) => powers(u, v).reduce(([x, y], power, index) => [x + power * fit[index][0], y + power * fit[index][1]], [0, 0]);

export function createTiles({ map, notice }) {
  const layer = map.layer("tiles");
  let server = null, shown = new Map(), failed = new Set(), isTold = false, waits = 0;

  // A place of the whole map, 0 .. 1 from the west and from the north, in centimetres of the plan; and the other way.
  const onPlan = (x, y) => {
    const { middle, size, centre, reach, toPlan } = server.frame;
    return sums(toPlan, (x - middle[0]) / size, (y - middle[1]) / size).map((value, axis) => centre[axis] + reach * value);
  };
  const onTiles = (east, north) => {
    const { middle, size, centre, reach, toTiles } = server.frame;
    return sums(toTiles, (east - centre[0]) / reach, (north - centre[1]) / reach).map((value, axis) => middle[axis] + size * value);
  };

  // Tiles that the window needs, as far as the fit reaches: [depth, column, row].
  function wanted() {
    const { centre, reach } = server.frame, { west, south, east, north, perCm } = map.window();
    const within = (value, axis) => Math.min(Math.max(value, centre[axis] - reach), centre[axis] + reach);
    const corners = [[west, south], [west, north], [east, south], [east, north]].map((place) => onTiles(...place.map(within)));
    const [low, high] = [Math.min, Math.max].map((end) => [0, 1].map((axis) => end(...corners.map((corner) => corner[axis]))));
    const perPx = Math.abs(onTiles(centre[0] + 100, centre[1])[0] - onTiles(centre[0], centre[1])[0]) / 100 / perCm;
    for (let depth = Math.min(Math.max(Math.round(Math.log2(1 / (TILE_PX * perPx))), 0), DEEPEST); ; depth -= 1) {
      const n = 2 ** depth, [from, to] = [low, high].map((corner) => corner.map((value) => Math.min(Math.max(Math.floor(value * n), 0), n - 1)));
      if ((to[0] - from[0] + 1) * (to[1] - from[1] + 1) > MOST && depth) continue;
      const found = [];
      for (let row = from[1]; row <= to[1]; row += 1) for (let column = from[0]; column <= to[0]; column += 1) found.push([depth, column, row]);
      return found;
    }
  }

  function fail(key) {
    shown.get(key)?.remove();
    shown.delete(key);
    failed.add(key);
    if (isTold) return;
    isTold = true;
    notice(tr("Some tiles from {server} did not load: nothing is drawn there.", { server: new URL(server.template).host }));
  }

  function put([depth, column, row], key) {
    const n = 2 ** depth, [corner, right, below] = [[0, 0], [1, 0], [0, 1]].map(([x, y]) => onPlan((column + x) / n, (row + y) / n));
    const along = right.map((value, axis) => value - corner[axis]), down = below.map((value, axis) => value - corner[axis]);
    const values = { z: depth, x: column, y: row };
    const href = server.template.replace(/\{([zxy])\}/g, (_, name) => values[name]);
    const image = element("image", { href, x: 0, y: 0, width: 1, height: 1, preserveAspectRatio: "none", "data-tile": key, transform: `matrix(${[...along, ...down, ...corner].join(" ")})` }, layer);
    image.addEventListener("error", () => fail(key));
    image.addEventListener("load", () => { image.dataset.loaded = ""; tidy(); });
    shown.set(key, image);
  }

  // Tiles that are no longer needed stay below until the new ones are there.
  let needed = new Set();
  function tidy() {
    if ([...needed].some((key) => shown.has(key) && !("loaded" in shown.get(key).dataset))) return;
    for (const [key, image] of shown) if (!needed.has(key)) { image.remove(); shown.delete(key); }
  }
  function lay() {
    waits = 0;
    const tiles = server?.frame && find("tiles").checked ? wanted() : [];
    needed = new Set(tiles.map((tile) => tile.join("/")));
    for (const tile of tiles) {
      const key = tile.join("/");
      if (!shown.has(key) && !failed.has(key)) put(tile, key);
    }
    tidy();
  }
  const layLater = () => { waits ||= requestAnimationFrame(lay); };

  function fade() {
    layer.setAttribute("opacity", find("tiles-opacity").valueAsNumber / 100);
  }
  function show() {
    const isOn = Boolean(server?.frame) && find("tiles").checked;
    find("attribution").hidden = find("tiles-opacity-row").hidden = !isOn;
    layLater();
  }
  find("tiles").addEventListener("change", () => { failed.clear(); isTold = false; show(); });
  find("tiles-opacity").addEventListener("input", fade);
  map.watch(layLater);
  fade();

  // The server, and how its tiles lie in this scene; null: none was named.
  function readScene(next) {
    server = next;
    shown.forEach((image) => image.remove());
    shown.clear();
    find("tiles-row").hidden = !server?.frame;
    find("tiles-none").hidden = !server || Boolean(server.frame);
    find("attribution").textContent = server?.attribution ?? "";
    show();
  }

  return { readScene };
}
