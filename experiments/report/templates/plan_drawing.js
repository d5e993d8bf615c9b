// The plan: a still ground in centimetres, marks of constant size above it.

const CAR_COLOUR = "#0072B2", ROAD_USER_COLOUR = "#D55E00", LAST_COLOUR = "#CC0000";
const MARKS = {
  camera: "M9 0L-7 5.5L-4 0L-7 -5.5Z",
  lidar: "M9 0L4 6H-6V-6H4Z",
  ring: "M7 0A7 7 0 1 1 -7 0A7 7 0 1 1 7 0ZM2 0A2 2 0 1 1 -2 0A2 2 0 1 1 2 0Z",
};
const points = (corners) => corners.map((corner) => corner.join(" ")).join(",");

function bodyCorners(motion, size, frame) {
  const yaw = motion.yaw[frame] * Math.PI / 1800;
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  return [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([ahead, left]) => {
    const [along, across] = [0.5 * size[0] * ahead, 0.5 * size[1] * left];
    return [motion.x[frame] + along * cos - across * sin, motion.y[frame] + along * sin + across * cos];
  });
}

// A wedge from the middle of the flanks to the nose.
function wedgeCorners([frontLeft, rearLeft, rearRight, frontRight]) {
  const middle = (a, b) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
  return [middle(frontLeft, frontRight), middle(frontLeft, rearLeft), middle(frontRight, rearRight)];
}

function addPatterns(svg) {
  const defs = element("defs", {}, svg);
  const crossed = element("pattern", { id: "road-user-fill", width: 26, height: 26, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" }, defs);
  element("rect", { width: 26, height: 26, fill: ROAD_USER_COLOUR }, crossed);
  element("path", { d: "M0 0H26M0 0V26", stroke: "#000", "stroke-width": 7 }, crossed);
  const dotted = element("pattern", { id: "parked-fill", width: 60, height: 60, patternUnits: "userSpaceOnUse" }, defs);
  element("rect", { width: 60, height: 60, fill: "#f2f2f2" }, dotted);
  element("circle", { cx: 30, cy: 30, r: 9, fill: "#777" }, dotted);
}

// The streets and what stands on them, in a group whose units are centimetres.
function drawGround(ground, plan) {
  const thin = { "vector-effect": "non-scaling-stroke" };
  element("rect", { x: -1e6, y: -1e6, width: 2e6, height: 2e6, fill: "#f4f2ee" }, ground);
  plan.classes.forEach((part) => {
    const isLane = part.name.includes("lane");
    const path = element("path", { d: part.path, fill: part.colour, "fill-rule": "evenodd", stroke: isLane ? "#fff" : "#8d887f", "stroke-width": part.name === "junction" ? 0 : 0.8, ...thin }, ground);
    element("title", { text: say(part.name) }, path);
  });
  plan.crosswalks.forEach((ends) => element("line", { x1: ends[0][0], y1: ends[0][1], x2: ends[1][0], y2: ends[1][1], stroke: "#fff", "stroke-width": 4, "stroke-dasharray": "3 3", ...thin }, ground));
}

// A bar of whole metres, and an arrow to the north.
function drawScale(scale, width, height, perCm) {
  const bar = [50, 20, 10, 5, 2, 1].find((metres) => metres * 100 * perCm < 0.3 * width) || 1;
  scale.replaceChildren();
  element("path", { d: `M12 ${height - 12}h${bar * 100 * perCm}`, stroke: "#000", "stroke-width": 4 }, scale);
  element("text", { text: `${bar} m`, x: 12, y: height - 18 }, scale);
  element("path", { d: `M${width - 18} 34V12l-4 8h8l-4 -8`, stroke: "#000", "stroke-width": 1.6, fill: "#000" }, scale);
  element("text", { text: say("N"), x: width - 22, y: 47, "font-weight": 700 }, scale);
}

const MARGIN_CM = 600, LEAST_HALF_CM = 2000, MOST_HALF_CM = 6000;

function squareAround(places) {
  const range = (axis) => [Math.min(...places.map((place) => place[axis])), Math.max(...places.map((place) => place[axis]))];
  const [[left, right], [bottom, top]] = [range(0), range(1)];
  const half = 0.5 * Math.max(right - left, top - bottom) + MARGIN_CM;
  return { middle: [(left + right) / 2, (bottom + top) / 2], half: Math.max(LEAST_HALF_CM, half) };
}

// The road user's way and the car from the last moment on; the units, too, unless all else becomes too small.
function windowOf(run, units) {
  const from = lastFrame(run);
  const way = (motion, first) => motion.x.map((x, index) => [x, motion.y[index]]).slice(first);
  const decisive = [...way(run.road, 0), ...way(run.car, from)];
  const whole = squareAround([...decisive, ...units.map((unit) => unit.place)]);
  return whole.half <= MOST_HALF_CM ? whole : squareAround(decisive);
}

function createPlan(holder, data) {
  const svg = element("svg", { role: "img", "aria-label": say("Plan of the junction with the run") }, holder);
  addPatterns(svg);
  const ground = element("g", { "stroke-linejoin": "round" }, svg);
  const marks = element("g", {}, svg);
  const thin = { "vector-effect": "non-scaling-stroke" };
  drawGround(ground, data.plan);
  const views = data.units.map((unit) => element("path", { d: unit.view, "fill-rule": "evenodd", fill: unit.colour, stroke: unit.colour, "stroke-dasharray": unit.dash, ...thin }, ground));
  const parked = element("g", {}, ground);
  const carWay = element("path", { fill: "none", stroke: "#000", "stroke-width": 1.2, ...thin }, ground);
  const roadWay = element("path", { fill: "none", stroke: "#000", "stroke-width": 1.6, "stroke-dasharray": "4 3", ...thin }, ground);
  const outlined = { stroke: "#000", "stroke-width": 1, ...thin };
  const car = element("polygon", { fill: CAR_COLOUR, ...outlined }, ground);
  const carWedge = element("polygon", { fill: "#fff", ...outlined }, ground);
  const road = element("polygon", { fill: "url(#road-user-fill)", ...outlined }, ground);

  const sites = data.plan.sites.map((place) => ({ place, mark: element("circle", { r: 2.2, fill: "#fff", stroke: "#444" }, marks) }));
  const arms = data.plan.arms.map((arm) => ({ place: arm.place, mark: element("text", { text: arm.name, "font-size": 12, "text-anchor": "middle", "paint-order": "stroke", stroke: "#fff", "stroke-width": 3, fill: "#333" }, marks) }));
  const lines = element("g", { stroke: "#000", "stroke-width": 1.1 }, marks);
  const lastMark = element("path", { d: "M-7 -7L7 7M-7 7L7 -7", stroke: LAST_COLOUR, "stroke-width": 3 }, marks);
  element("title", { text: say("centre of the car at the last moment to brake") }, lastMark);
  const ring = element("circle", { r: 10, fill: "none", stroke: ROAD_USER_COLOUR, "stroke-width": 2, "stroke-dasharray": "4 2" }, marks);
  const units = data.units.map((unit) => {
    const mark = element("g", { class: "unit" }, marks);
    element("title", { text: unit.title }, mark);
    const yaw = unit.yaw * Math.PI / 1800;
    const look = [Math.cos(yaw), -Math.sin(yaw)];
    const halo = element("circle", { r: 12, fill: "none", stroke: "#000", "stroke-width": 2.2 }, mark);
    const sign = element("path", { d: MARKS[unit.kind], transform: `rotate(${-unit.yaw / 10})`, stroke: "#000", "stroke-width": 1.2 }, mark);
    const diamond = element("path", { d: "M0 -6L6 0L0 6L-6 0Z", fill: "#fff", stroke: "#000", "stroke-width": 1.6, transform: `translate(${-15 * look[0]} ${-15 * look[1]})` }, mark);
    if (data.units.length <= 24) {
      element("text", { text: unit.name, x: 20 * look[0], y: 20 * look[1] + 4, "font-size": 12, "font-weight": 700, "text-anchor": look[0] > 0.3 ? "start" : look[0] < -0.3 ? "end" : "middle", "paint-order": "stroke", stroke: "#fff", "stroke-width": 3 }, mark);
    }
    return { unit, mark, halo, sign, diamond, line: element("line", { "stroke-dasharray": unit.dash }, lines) };
  });
  const carLine = element("line", { stroke: CAR_COLOUR, "stroke-width": 2 }, lines);
  const scale = element("g", { "font-size": 11 }, marks);

  let run = null, frame = 0, zoom = 0, width = 0, height = 0, perCm = 1, origin = [0, 0];
  const at = ([x, y]) => [origin[0] + x * perCm, origin[1] - y * perCm];
  const put = (mark, place) => { const [x, y] = at(place); mark.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`); };
  const draw = (line, from, to) => {
    const [[x1, y1], [x2, y2]] = [at(from), at(to)];
    for (const [name, value] of Object.entries({ x1, y1, x2, y2 })) line.setAttribute(name, value.toFixed(1));
  };

  function layOut() {
    width = Math.max(holder.clientWidth, 200);
    height = Math.min(width, 620);
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("width", width);
    svg.setAttribute("height", height);
    const final = run.time.length - 1;
    const shown = windowOf(run, data.units);
    const middle = zoom <= 0 ? shown.middle : [run.road.x[final], run.road.y[final]];
    const half = shown.half / 1.6 ** zoom;
    perCm = 0.5 * Math.min(width, height) / half;
    origin = [0.5 * width - middle[0] * perCm, 0.5 * height + middle[1] * perCm];
    ground.setAttribute("transform", `matrix(${perCm} 0 0 ${-perCm} ${origin[0]} ${origin[1]})`);
    [...sites, ...arms].forEach(({ mark, place }) => put(mark, place));
    units.forEach(({ mark, unit }) => put(mark, unit.place));
    lastMark.style.display = run.lastPlace ? "" : "none";
    if (run.lastPlace) put(lastMark, run.lastPlace);
    drawScale(scale, width, height, perCm);
    showFrame(frame);
  }

  function showRun(next) {
    run = next;
    frame = Math.min(frame, run.time.length - 1);
    const way = (motion) => "M" + motion.x.map((x, index) => `${x} ${motion.y[index]}`).join("L");
    carWay.setAttribute("d", way(run.car));
    roadWay.setAttribute("d", way(run.road));
    parked.replaceChildren();
    run.parked.forEach((body) => {
      const box = element("polygon", { points: points(body.corners), fill: "url(#parked-fill)", stroke: "#666", ...thin }, parked);
      element("title", { text: say("parked: {name}", { name: say(body.name) }) }, box);
    });
  }

  function showFrame(next) {
    frame = next;
    const place = [run.road.x[frame], run.road.y[frame]];
    const corners = bodyCorners(run.car, run.carSize, frame);
    car.setAttribute("points", points(corners));
    carWedge.setAttribute("points", points(wedgeCorners(corners)));
    road.setAttribute("points", points(bodyCorners(run.road, run.roadSize, frame)));
    put(ring, place);
    units.forEach(({ unit, mark, halo, sign, diamond, line }, index) => {
      const detects = run.detected[index + 1][frame];
      const confirmed = run.confirmed[index + 1];
      const hasConfirmed = confirmed !== null && confirmed <= run.time[frame];
      mark.classList.toggle("detects", Boolean(detects));
      mark.classList.toggle("confirmed", hasConfirmed);
      halo.style.display = line.style.display = detects ? "" : "none";
      diamond.style.display = hasConfirmed ? "" : "none";
      sign.setAttribute("fill", detects ? unit.colour : "#fff");
      views[index].setAttribute("fill-opacity", detects ? 0.3 : Math.min(0.08, 0.6 / units.length));
      views[index].setAttribute("stroke-width", detects ? 2.4 : 0.9);
      views[index].setAttribute("stroke-opacity", detects ? 1 : Math.max(0.15, Math.min(0.8, 8 / units.length)));
      if (detects) draw(line, unit.place, place);
    });
    carLine.style.display = run.detected[0][frame] ? "" : "none";
    if (run.detected[0][frame]) draw(carLine, [run.car.x[frame], run.car.y[frame]], place);
  }

  return {
    showRun, showFrame, layOut,
    zoomBy(step) { zoom = Math.max(-2, Math.min(6, zoom + step)); layOut(); },
  };
}

function fillKey(list, data) {
  const add = (text, draw) => {
    const item = element("li", {}, list);
    draw(element("svg", { width: 26, height: 26, viewBox: "-13 -13 26 26", "aria-hidden": "true" }, item));
    element("span", { text }, item);
  };
  const path = (attributes) => (svg) => element("path", { stroke: "#000", "stroke-width": 1.2, ...attributes }, svg);
  add(say("car under test (VUT), its way"), path({ d: "M-11 -5H11V5H-11Z", fill: CAR_COLOUR }));
  add(say("road user, its way (dashed)"), (svg) => {
    element("rect", { x: -3, y: -3, width: 6, height: 6, fill: ROAD_USER_COLOUR, stroke: "#000" }, svg);
    element("circle", { r: 10, fill: "none", stroke: ROAD_USER_COLOUR, "stroke-width": 2, "stroke-dasharray": "4 2" }, svg);
  });
  const kinds = [
    ["camera", say("camera: detects nothing now"), say("camera: detects")],
    ["lidar", say("LiDAR: detects nothing now"), say("LiDAR: detects")],
    ["ring", say("LiDAR that scans all round: detects nothing now"), say("LiDAR that scans all round: detects")],
  ];
  for (const [kind, detectsNothing, detects] of kinds) {
    if (!data.units.some((unit) => unit.kind === kind)) continue;
    add(detectsNothing, path({ d: MARKS[kind], fill: "#fff" }));
    add(detects, (svg) => {
      path({ d: MARKS[kind], fill: CAR_COLOUR })(svg);
      element("circle", { r: 12, fill: "none", stroke: "#000", "stroke-width": 2.2 }, svg);
    });
  }
  add(say("has confirmed"), path({ d: "M0 -6L6 0L0 6L-6 0Z", fill: "#fff" }));
  add(say("centre of the car at the last moment"), path({ d: "M-7 -7L7 7M-7 7L7 -7", stroke: LAST_COLOUR, "stroke-width": 3 }));
  if (data.runs.some((run) => run.parked.length)) add(say("parked vehicle or wall of the case"), path({ d: "M-11 -6H11V6H-11Z", fill: "#f2f2f2", "stroke-dasharray": "2 2" }));
}
