// The view in three dimensions: the library is read only when somebody asks for it.

const DOT_DISTANCE_CM = 150;

// Without a player there are no ways, and the view is drawn at once.
function startView(player) {
  const find = (id) => document.getElementById(id);
  const [holder, message, showButton, buttons] = ["view-3d", "view-message", "view-show", "view-buttons"].map(find);
  const ways = ["car", "road", "impact", "parked"];
  let run = null, isShown = false, firstWay = 0;
  find("turn").hidden = false;
  player?.onRun((next) => { run = next; if (isShown) drawWays(); });

  function hasWebGl() {
    const canvas = document.createElement("canvas");
    const context = canvas.getContext("webgl2") || canvas.getContext("webgl");
    if (context) context.getExtension("WEBGL_lose_context")?.loseContext();
    return Boolean(context);
  }

  // plotly.js draws letters on a canvas and reads them back; browsers warn unless told before.
  function readOften() {
    const { prototype } = HTMLCanvasElement;
    const { getContext } = prototype;
    prototype.getContext = function getReadableContext(kind, options) {
      return getContext.call(this, kind, kind === "2d" ? { willReadFrequently: true, ...options } : options);
    };
    return () => { prototype.getContext = getContext; };
  }

  // Packed, as it would be most of the page's size.
  async function readLibrary() {
    const packed = Uint8Array.from(atob(find("plotly-source").textContent), (sign) => sign.charCodeAt(0));
    const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(unpacked).text();
    document.head.append(script);
    return window.Plotly;
  }

  const metres = (values) => values.map((value) => value / 100);

  // Dots at least so far apart: plotly.js draws dashes of lines by the distance from the eye.
  function spaced(motion) {
    const kept = { x: [], y: [], ground: [] };
    motion.x.forEach((x, index) => {
      const [last, y] = [kept.x.length - 1, motion.y[index]];
      if (last >= 0 && Math.hypot(x - kept.x[last], y - kept.y[last]) < DOT_DISTANCE_CM) return;
      kept.x.push(x);
      kept.y.push(y);
      kept.ground.push(motion.ground[index]);
    });
    return kept;
  }

  function wayTraces() {
    // Heights of the ground are only there where it is not flat.
    const level = (motion, ground) => ({ ...motion, ground: ground ?? motion.x.map(() => 0) });
    const [car, road] = [level(run.car, run.carGround), level(run.road, run.roadGround)];
    const way = (motion, height = 0.4) => ({ x: metres(motion.x), y: metres(motion.y), z: motion.ground.map((ground) => ground / 100 + height) });
    const final = run.road.x.length - 1, foot = road.ground[final] / 100;
    const corners = [[], [], []], sides = [[], [], []], names = [];
    run.parked.forEach((body, index) => {
      const ground = run.parkedGround?.[index] ?? 0;
      const base = corners[0].length;
      for (const height of [ground, ground + body.height]) body.corners.forEach(([x, y]) => {
        [x, y, height].forEach((value, axis) => corners[axis].push(value / 100));
        names.push(`parked: ${body.name}`);
      });
      [[4, 5, 6], [4, 6, 7], ...[0, 1, 2, 3].flatMap((a) => { const b = (a + 1) % 4; return [[a, b, b + 4], [a, b + 4, a + 4]]; })]
        .forEach((triangle) => triangle.forEach((corner, axis) => sides[axis].push(base + corner)));
    });
    return [
      { ...way(car, 0.8), type: "scatter3d", mode: "lines", name: "way of the car", hoverinfo: "name", line: { color: "#000000", width: 6 } },
      { ...way(spaced(road)), type: "scatter3d", mode: "markers", name: `way of the ${run.user}`, hoverinfo: "name", marker: { symbol: "circle", size: 2.5, color: "#D55E00" } },
      { x: Array(2).fill(run.road.x[final] / 100), y: Array(2).fill(run.road.y[final] / 100), z: [foot, foot + 4], text: ["", "impact"], textposition: "top center", textfont: { size: 14, color: "#A80000" }, type: "scatter3d", mode: "lines+text", name: "impact", hoverinfo: "name", line: { color: "#CC0000", width: 8 } },
      { x: corners[0], y: corners[1], z: corners[2], i: sides[0], j: sides[1], k: sides[2], text: names, hoverinfo: "text", type: "mesh3d", name: "parked in this run", color: "#f2f2f2", flatshading: true, lighting: { ambient: 0.85, diffuse: 0.2, specular: 0, fresnel: 0 }, showlegend: run.parked.length > 0 },
    ];
  }

  function drawWays() {
    const traces = wayTraces();
    const update = {};
    for (const key of ["x", "y", "z", "i", "j", "k", "text", "name", "showlegend"]) update[key] = traces.map((trace) => trace[key]);
    window.Plotly.restyle(holder, update, ways.map((_, index) => firstWay + index));
  }

  function layout(data) {
    const [x, y] = data.middle;
    const axis = (title, range) => ({ title: { text: title }, range, showbackground: false, gridcolor: "#dddddd", zeroline: false });
    return {
      font: { family: "system-ui, DejaVu Sans, sans-serif", size: 11 },
      margin: { l: 0, r: 0, t: 0, b: 0 },
      showlegend: true,
      legend: { orientation: "h", y: 0, yanchor: "top", font: { size: 10 } },
      uirevision: "keep",
      scene: {
        dragmode: "turntable",
        aspectmode: "manual",
        aspectratio: { x: 1.6, y: 1.6, z: 1.6 * (data.top - data.bottom) / (2 * data.half) },
        xaxis: axis("east (m)", [x - data.half, x + data.half]),
        yaxis: axis("north (m)", [y - data.half, y + data.half]),
        zaxis: axis("up (m)", [data.bottom, data.top]),
        camera: { eye: { x: -0.8, y: -1.05, z: 1.35 }, center: { x: 0, y: 0, z: -0.1 } },
      },
    };
  }

  function wholeNumbers(trace) {
    if (!trace.names) return trace;
    const { names, nameIndex, ...rest } = trace;
    return { ...rest, text: nameIndex.map((index) => names[index]), hoverinfo: "text" };
  }

  async function show() {
    showButton.disabled = true;
    message.textContent = "";
    if (!hasWebGl()) {
      message.textContent = "This browser has no WebGL, so there is no view in three dimensions; the plan above shows the same from above.";
      return;
    }
    message.textContent = "The view is being drawn \u2026";
    const restore = readOften();
    await new Promise((resume) => setTimeout(resume, 30)); // so that the line above is seen
    try {
      const library = await readLibrary();
      const data = JSON.parse(find("view-data").textContent);
      const still = data.traces.map(wholeNumbers);
      firstWay = still.length;
      holder.hidden = false;
      await library.newPlot(holder, [...still, ...(run ? wayTraces() : [])], layout(data), { displaylogo: false, responsive: true, modeBarButtons: [["toImage", "resetCameraDefault3d"]] });
      isShown = true;
      if (run) drawWays();
      buttons.hidden = false;
      showButton.parentElement.hidden = true;
      message.textContent = "";
    } catch (error) {
      holder.hidden = true;
      message.textContent = `The view cannot be drawn here (${error.message}); the plan above shows the same from above.`;
    } finally {
      restore();
    }
  }

  function turn(way) {
    const camera = structuredClone(holder._fullLayout.scene._scene.getCamera());
    const { eye, center } = camera;
    const [dx, dy, dz] = [eye.x - center.x, eye.y - center.y, eye.z - center.z];
    let [around, flat, distance] = [Math.atan2(dy, dx), Math.hypot(dx, dy), Math.hypot(dx, dy, dz)];
    let up = Math.atan2(dz, flat);
    if (way === "left") around -= Math.PI / 12;
    if (way === "right") around += Math.PI / 12;
    if (way === "up") up = Math.min(1.5, up + 0.15);
    if (way === "down") up = Math.max(0.02, up - 0.15);
    if (way === "closer") distance = Math.max(0.15, distance / 1.25);
    if (way === "farther") distance = Math.min(6, distance * 1.25);
    if (way === "above") [around, up, distance] = [-Math.PI / 2, 1.55, Math.max(distance, 1.6)];
    flat = distance * Math.cos(up);
    camera.eye = { x: center.x + flat * Math.cos(around), y: center.y + flat * Math.sin(around), z: center.z + distance * Math.sin(up) };
    window.Plotly.relayout(holder, { "scene.camera": camera });
  }

  showButton.addEventListener("click", show);
  buttons.addEventListener("click", (event) => { if (event.target.dataset.turn) turn(event.target.dataset.turn); });
  if (!player) show();
}
