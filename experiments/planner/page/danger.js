// Where it is still dangerous: the weight of lost runs around each place of the road.

import { element } from "./shared.js";
import { number, tr } from "./words.js";

const REACH_CM = 200, CELL_CM = 50;
// Shares of the weight of all runs from which a band begins; the darker the more, in grey, too.
const BANDS = [[0.1, "#5e1d03"], [0.05, "#8c2d04"], [0.02, "#cc4c02"], [0.01, "#ec7014"], [0.005, "#fe9929"], [0, "#fec44f"]];

// Sum of the weights of points within reach of each cell's middle: `points` are [x, y, weight].
function sums(points) {
  const cells = new Map(), steps = Math.ceil(REACH_CM / CELL_CM);
  for (const [x, y, weight] of points) {
    const [column, row] = [Math.floor(x / CELL_CM), Math.floor(y / CELL_CM)];
    for (let i = column - steps; i <= column + steps; i += 1) for (let j = row - steps; j <= row + steps; j += 1) {
      if (Math.hypot((i + 0.5) * CELL_CM - x, (j + 0.5) * CELL_CM - y) > REACH_CM) continue;
      const key = `${i} ${j}`;
      cells.set(key, (cells.get(key) ?? 0) + weight);
    }
  }
  return cells;
}

export function drawDanger(layer, points) {
  layer.replaceChildren();
  const paths = BANDS.map(() => []);
  for (const [key, sum] of sums(points)) {
    const [i, j] = key.split(" ").map(Number);
    const band = BANDS.findIndex(([least]) => sum > least - 1e-9 && (least || sum > 0));
    if (band >= 0) paths[band].push(`M${i * CELL_CM} ${j * CELL_CM}h${CELL_CM}v${CELL_CM}h${-CELL_CM}Z`);
  }
  paths.forEach((cells, band) => { if (cells.length) element("path", { d: cells.join(""), fill: BANDS[band][1], "fill-opacity": 0.9, "data-band": band }, layer); });
}

// The legend, and the sum in words.
export function fillDangerKey(holder, points) {
  const percent = (share) => `${number(Number((100 * share).toFixed(1)))} %`;
  const all = points.reduce((sum, point) => sum + point[2], 0);
  if (!points.length) { holder.textContent = tr("No run is lost: nothing is drawn."); return; }
  const lost = tr("Lost runs by where they end: {n}, with {share} of the total weight. Share of their weight within {reach} m of a point:", { n: points.length, share: percent(all), reach: REACH_CM / 100 });
  holder.replaceChildren(`${lost} `, ...BANDS.map(([least, fill], band) => {
    const item = element("span", { class: "key" });
    element("rect", { width: 12, height: 12, fill, stroke: "#333" }, element("svg", { width: 12, height: 12, "aria-hidden": "true" }, item));
    const said = { least: percent(least), most: percent(BANDS[band - 1]?.[0]) };
    item.append(` ${band === 0 ? tr("{least} and more", said) : least ? tr("{least} to {most}", said) : tr("up to {most}", said)} `);
    return item;
  }));
}
