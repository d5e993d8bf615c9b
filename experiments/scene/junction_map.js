// A street map that is zoomed and moved, and the list of its junctions: see junction_map.html.j2.

const MARK_PX = 8, NAME_PX = 11, LETTER_PX = 6; // a junction's radius; a street's name, and a letter of it
const NEAREST_M = 40, CHOSEN_M = 600, MOST_NAMES = 150;
const STEP = 0.6, KEY_STEP = 0.15; // of a zoom button; of an arrow, as a share of the map's width

// The map in `root`: zoomed by wheel, pinch, buttons and keys; `marks` are groups that keep their size.
function openStreetMap(root) {
  const map = root.querySelector(".street-map"), part = (name) => root.querySelector(name);
  const names = [...map.querySelectorAll(".street-names text")].map((text) => {
    const [x, y, turn] = text.getAttribute("transform").match(/-?[\d.]+/g).map(Number);
    return { text, x, y, turn, reach: LETTER_PX * text.textContent.length / 2 };
  });
  const { x, y, width, height } = map.viewBox.baseVal, home = [x, y, width, height];
  let view = [...home];

  // Marks and names keep their size on the screen; of names as many are there as fit beside each other.
  function draw() {
    map.setAttribute("viewBox", view.join(" "));
    const unit = Math.max(view[2] / map.clientWidth, view[3] / map.clientHeight);
    if (!Number.isFinite(unit) || unit <= 0) return; // nothing is shown yet
    map.querySelectorAll(":scope > circle").forEach((one) => { one.setAttribute("r", MARK_PX * unit); one.setAttribute("stroke-width", 1.5 * unit); });
    map.querySelectorAll(".mark").forEach((one) => one.setAttribute("transform", `translate(${one.dataset.x} ${one.dataset.y}) scale(${unit})`));
    const [half, tall] = [map.clientWidth * unit / 2, map.clientHeight * unit / 2];
    const [east, south] = [view[0] + view[2] / 2, view[1] + view[3] / 2];
    const kept = [];
    map.querySelector(".street-names").setAttribute("font-size", NAME_PX * unit);
    for (const name of names) {
      const isNear = Math.abs(name.x - east) < half && Math.abs(name.y - south) < tall && kept.length < MOST_NAMES;
      const fits = isNear && kept.every((other) => Math.hypot(other.x - name.x, other.y - name.y) > (other.reach + name.reach) * unit);
      name.text.setAttribute("display", fits ? "inline" : "none");
      if (fits) kept.push(name);
    }
  }

  function zoom(factor, x = view[0] + view[2] / 2, y = view[1] + view[3] / 2) {
    const width = Math.min(Math.max(view[2] * factor, NEAREST_M), 2 * Math.max(home[2], home[3]));
    const by = width / view[2];
    view = [x - (x - view[0]) * by, y - (y - view[1]) * by, width, view[3] * by];
    draw();
  }
  function move(across, down) {
    view[0] += across;
    view[1] += down;
    draw();
  }
  function whole() {
    view = [...home];
    draw();
  }
  // Bring places to the middle, no nearer than so many metres across.
  function show(places, least = CHOSEN_M) {
    const [low, high] = [Math.min, Math.max].map((end) => [0, 1].map((axis) => end(...places.map((place) => place[axis]))));
    const span = Math.max(1.4 * (high[0] - low[0]), 1.4 * (high[1] - low[1]) * home[2] / home[3], Math.min(view[2], least));
    const size = Math.min(span, home[2]);
    view = [(low[0] + high[0] - size) / 2, (low[1] + high[1] - size * home[3] / home[2]) / 2, size, size * home[3] / home[2]];
    draw();
  }

  const point = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(map.getScreenCTM().inverse());
  map.addEventListener("wheel", (event) => {
    event.preventDefault();
    const { x, y } = point(event);
    zoom(Math.exp(0.0015 * event.deltaY * (event.deltaMode ? 40 : 1) * (event.ctrlKey ? 5 : 1)), x, y); // a pinch on a trackpad is a wheel with Ctrl
  }, { passive: false });
  const held = new Map();
  map.addEventListener("pointerdown", (event) => held.set(event.pointerId, event));
  map.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const others = [...held.values()].filter((one) => one.pointerId !== event.pointerId);
    const from = point(before), to = point(event);
    if (others.length) {
      const pivot = point(others[0]);
      const apart = (one) => Math.hypot(one.x - pivot.x, one.y - pivot.y);
      if (apart(to) > 0) zoom(apart(from) / apart(to), pivot.x, pivot.y);
    } else move(from.x - to.x, from.y - to.y);
    held.set(event.pointerId, event);
  });
  for (const end of ["pointerup", "pointercancel", "pointerleave"]) map.addEventListener(end, (event) => held.delete(event.pointerId));
  map.addEventListener("keydown", (event) => {
    const step = KEY_STEP * view[2];
    const acts = {
      ArrowLeft: () => move(-step, 0), ArrowRight: () => move(step, 0), ArrowUp: () => move(0, -step), ArrowDown: () => move(0, step),
      "+": () => zoom(STEP), "-": () => zoom(1 / STEP), 0: whole,
    };
    if (!acts[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    acts[event.key]();
  });
  part(".map-nearer").addEventListener("click", () => zoom(STEP));
  part(".map-farther").addEventListener("click", () => zoom(1 / STEP));
  part(".map-all").addEventListener("click", whole);
  new ResizeObserver(draw).observe(map);
  part(".map-zoom").hidden = false;
  draw();
  return { map, draw, show, whole };
}

// The map with its list: `onChoose` gets id and name of each junction that is chosen.
function openJunctionMap(root, onChoose) {
  const { map, show, whole } = openStreetMap(root), part = (name) => root.querySelector(name);
  const circles = [...map.querySelectorAll("circle")], rows = [...root.querySelectorAll("li button")];
  const isUsable = (index) => rows[index].getAttribute("aria-disabled") !== "true";
  const placeOf = (index) => ["cx", "cy"].map((name) => Number(circles[index].getAttribute(name)));

  function choose(index) {
    rows[index].scrollIntoView({ block: "nearest" });
    if (!isUsable(index)) { part(".map-count").textContent = rows[index].querySelector(".map-why").textContent; return; }
    circles.forEach((one, number) => one.classList.toggle("chosen", number === index));
    rows.forEach((one, number) => one.setAttribute("aria-pressed", number === index));
    onChoose({ id: rows[index].dataset.id, name: rows[index].firstChild.textContent });
  }
  // A junction that was tried and cannot be used: grey from now on, with the reason.
  function refuse(id, why) {
    const index = rows.findIndex((row) => row.dataset.id === id);
    rows[index].setAttribute("aria-disabled", "true");
    rows[index].setAttribute("aria-pressed", "false");
    rows[index].querySelector(".map-why").textContent = why;
    circles[index].setAttribute("class", "unusable");
    circles[index].querySelector("title").textContent += `: ${why}`;
  }
  function filter() {
    const wanted = part(".map-find").value.toLowerCase().split(/[\s/]+/).filter(Boolean);
    const known = rows.map((row) => `${row.firstChild.textContent} ${row.dataset.id}`.toLowerCase());
    const found = known.map((text) => wanted.every((word) => text.includes(word)));
    rows.forEach((row, index) => { row.parentElement.hidden = !found[index]; circles[index].classList.toggle("other", !found[index]); });
    const places = rows.flatMap((row, index) => (found[index] ? [placeOf(index)] : []));
    part(".map-count").textContent = `${places.length} / ${rows.length}`;
    if (!wanted.length) whole();
    else if (places.length) show(places);
  }

  circles.forEach((one, index) => one.addEventListener("click", () => choose(index)));
  rows.forEach((one, index) => {
    one.addEventListener("click", () => { choose(index); show([placeOf(index)]); });
    one.addEventListener("keydown", (event) => {
      const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
      if (!step) return;
      event.preventDefault();
      const seen = rows.filter((row) => !row.parentElement.hidden);
      seen[seen.indexOf(one) + step]?.focus();
    });
  });
  part(".map-find").addEventListener("input", filter);
  part(".map-find").addEventListener("keydown", (event) => {
    if (event.key !== "Enter" && event.key !== "ArrowDown") return;
    event.preventDefault();
    rows.find((row) => !row.parentElement.hidden)?.focus();
  });
  part(".map-finding").hidden = false;
  return { choose, refuse, first: () => rows.findIndex((row, index) => isUsable(index)) };
}
