// Who detects when: a row per party, a column per frame, and a line where the player is.

const DETECTED = "#0072B2", MISSED = "#e6e6e6";

function createHeatmap(holder, parties, onPick) {
  const rowHeight = parties.length > 40 ? 12 : 18;
  const fontSize = parties.length > 40 ? 10 : 12;
  holder.classList.toggle("many", parties.length > 40); // too long for paper
  const [top, bottom] = [26, 36];
  let svg = null, run = null, frame = 0, cellWidth = 1, left = 0, head = null;
  const short = (text, length) => (text.length > length ? text.slice(0, length - 1) + "\u2026" : text);

  function layOut() {
    const width = Math.max(holder.clientWidth - 2, 240);
    const n = run.time.length;
    left = Math.min(112, 0.27 * width);
    const right = 102; // "never confirmed"
    cellWidth = (width - left - right) / n;
    const rows = parties.length * rowHeight;
    holder.replaceChildren();
    svg = element("svg", { width, height: top + rows + bottom, viewBox: `0 0 ${width} ${top + rows + bottom}`, "font-size": fontSize, role: "img", "aria-label": say("Who detects the road user when: {run}. The table below says the same.", { run: run.title }) }, holder);
    const letters = Math.floor(left / (0.64 * fontSize));
    const x = (index) => left + index * cellWidth;
    parties.forEach((party, index) => {
      const y = top + index * rowHeight;
      const label = element("text", { text: short(party.name, letters), x: left - 4, y: y + 0.5 * rowHeight + 0.36 * fontSize, "text-anchor": "end" }, svg);
      element("title", { text: party.name }, label);
      const inner = rowHeight - 2;
      element("rect", { x: left, y: y + 1, width: n * cellWidth, height: inner, fill: MISSED }, svg);
      const d = stretches(run.detected[index]).map(([first, last]) => `M${x(first).toFixed(2)} ${y + 1}h${((last - first + 1) * cellWidth).toFixed(2)}v${inner}h${(-(last - first + 1) * cellWidth).toFixed(2)}Z`).join("");
      if (d) element("path", { d, fill: DETECTED, class: "detections" }, svg);
      element("text", { text: outcome(run, index), x: width - right + 5, y: y + 0.5 * rowHeight + 0.36 * fontSize, "font-size": Math.min(fontSize, 11), "font-weight": run.avoided[index] ? 700 : 400 }, svg);
    });
    const placeOf = (ms) => { const share = shareOf(run, ms); return share === null ? null : left + (0.5 + share * (n - 1)) * cellWidth; };
    drawTimes(placeOf, top + rows);
    const last = placeOf(run.last);
    if (last !== null) {
      const line = { x1: last, x2: last, y1: top - 4, y2: top + rows + 2 };
      element("line", { ...line, stroke: "#fff", "stroke-width": 3.6 }, svg);
      element("line", { ...line, stroke: LAST_COLOUR, "stroke-width": 2, "stroke-dasharray": "5 3" }, svg);
    }
    head = element("g", { class: "playhead" }, svg);
    element("path", { d: `M0 ${top - 1}l-5 -8h10Z`, fill: "#000" }, head);
    element("line", { y1: top, y2: top + rows, stroke: "#fff", "stroke-width": 4 }, head);
    element("line", { y1: top, y2: top + rows, stroke: "#000", "stroke-width": 2 }, head);
    parties.forEach((_, index) => {
      const place = placeOf(run.confirmed[index]);
      if (place === null) return;
      const mark = element("path", { d: "M0 -5L5 0L0 5L-5 0Z", fill: "#fff", stroke: "#000", transform: `translate(${place} ${top + (index + 0.5) * rowHeight})` }, svg);
      element("title", { text: say("confirmed at {time} s", { time: seconds(run.confirmed[index]) }) }, mark);
    });
    element("text", { text: run.last === null ? say("no braking avoids this impact") : last === null ? say("the last moment is before the first frame") : say("last moment {time} s", { time: seconds(run.last) }), x: last === null ? left : last, y: 14, fill: "#A80000", "text-anchor": last !== null && last > left + 0.5 * n * cellWidth ? "end" : "start" }, svg);
    svg.addEventListener("click", (event) => {
      const index = Math.floor((event.clientX - svg.getBoundingClientRect().left - left) / cellWidth);
      if (index >= 0 && index < n) onPick(index);
    });
    showFrame(frame);
  }

  function drawTimes(placeOf, y) {
    const [first, last] = [run.time[0], run.time[run.time.length - 1]];
    const room = Math.max(cellWidth * run.time.length / 48, 1);
    const step = [100, 200, 500, 1000, 2000, 5000, 10000].find((ms) => (last - first) / ms <= room) || 20000;
    for (let ms = Math.ceil(first / step) * step; ms <= last; ms += step) {
      element("text", { text: seconds(ms, 1), x: placeOf(ms), y: y + 14, "text-anchor": "middle", "font-size": 11 }, svg);
    }
    element("text", { text: say("time before the impact (s)"), x: left, y: y + 30, "font-size": 11 }, svg);
  }

  function showFrame(next) {
    frame = next;
    head.setAttribute("transform", `translate(${(left + (frame + 0.5) * cellWidth).toFixed(1)} 0)`);
  }

  return { layOut, showFrame, showRun(next) { run = next; frame = Math.min(frame, run.time.length - 1); } };
}

function fillTable(table, parties, run) {
  table.caption.textContent = say("Who detects when: {run}", { run: run.title });
  const [body] = table.tBodies;
  body.replaceChildren();
  parties.forEach((party, index) => {
    const row = element("tr", {}, body);
    element("th", { scope: "row", text: party.name }, row);
    const when = (ms) => (ms === null ? say("never") : seconds(ms));
    [inWords(run.detected[index], run.time), when(run.confirmed[index]), when(run.onset[index]), outcome(run, index)]
      .forEach((text) => element("td", { text }, row));
  });
}
