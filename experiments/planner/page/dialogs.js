// What opens above the plan: a run that is lost, junctions of a map, the background image, files.

import { createJunctions } from "./junctions.js";
import { ask, give } from "./line.js";
import { element } from "./shared.js";
import { tr, trn } from "./words.js";

const find = (id) => document.getElementById(id);
const PLANS = [".json"];

export function openDialogs({ map, notice, scene, state, saved, send }) {
  const hasUnits = () => state()?.variants.some((variant) => variant.units);
  const junctions = createJunctions({ notice, scene, hasUnits, send });
  document.querySelectorAll("dialog [data-close]").forEach((button) => button.addEventListener("click", () => button.closest("dialog").close()));

  // ---------- a run

  let run = null, shown = "";
  async function showRun(next, outcome) {
    run = next;
    for (const id of ["picture", "player"]) find(id).hidden = true;
    find("player").removeAttribute("src");
    find("play").hidden = false;
    find("picture-text").textContent = "";
    find("run-title").textContent = `${run.title}: ${outcome}`;
    find("run-why").textContent = tr("Why: computing \u2026");
    fill(find("picture-unit"), [...state().units.map((unit) => unit.id), "VUT"]);
    fill(find("picture-frame"), Array.from({ length: run.frames }, (_, frame) => [frame - run.frames, frame === run.frames - 1 ? tr("at the impact") : tr("{n} before the impact", { n: run.frames - 1 - frame })]));
    find("picture-frame").value = Math.max(-run.frames, -15);
    if (!find("run-dialog").open) find("run-dialog").showModal();
    const asked = run;
    try {
      const message = await ask("explain", { run: run.id });
      if (run === asked) explain(message);
    } catch (error) {
      if (run === asked) find("run-why").textContent = tr("Why: {reason}", { reason: error.message });
    }
  }

  function fill(select, values) {
    select.replaceChildren(...values.map((value) => element("option", Array.isArray(value) ? { value: value[0], text: value[1] } : { value, text: value })));
  }

  function explain(message) {
    const holder = find("run-why");
    holder.replaceChildren();
    element("p", { text: message.inTime ? trn("{n} frame comes early enough to brake. In it:", "{n} frames come early enough to brake. In these:", message.inTime) : tr("No frame comes early enough: no sensor could help.") }, holder);
    const list = element("ul", {}, holder);
    if (message.inTime) message.units.forEach((unit) => element("li", { text: tr("{unit} detects the road user in {detected}; in the others: {reasons}.", { ...unit, reasons: unit.reasons.map((reason) => `${reason.words} (${reason.frames})`).join(", ") }) }, list));
    // A frame that matters most, of those in time: the last one.
    const times = message.frames;
    [...find("picture-frame").options].forEach((option, index) => { option.textContent = index < message.inTime ? tr("{time}, in time", times[index]) : times[index].time; });
    if (message.inTime) find("picture-frame").value = message.inTime - 1 - run.frames;
  }

  find("picture-show").addEventListener("click", async () => {
    const asked = run;
    find("picture-text").textContent = tr("Rendering \u2026");
    try {
      const values = { run: run.id, unit: find("picture-unit").value, frame: find("picture-frame").value };
      const picture = await ask("picture", values);
      if (run !== asked) return;
      if (shown) URL.revokeObjectURL(shown);
      shown = URL.createObjectURL(picture);
      const said = { unit: values.unit, when: find("picture-frame").selectedOptions[0].textContent };
      Object.assign(find("picture"), { src: shown, hidden: false, alt: tr("What {unit} sees, {when}", said) });
      find("picture-text").textContent = tr("What {unit} sees, {when}; rendered.", said);
    } catch (error) {
      find("picture-text").textContent = error.message;
    }
  });

  find("play").addEventListener("click", () => {
    const player = find("player");
    player.src = `watch?${new URLSearchParams({ run: run.id })}`;
    player.hidden = false;
    find("play").hidden = true;
  });

  // ---------- files

  async function open(file) {
    const headers = { "X-File-Name": encodeURIComponent(file.name) };
    if (!PLANS.some((end) => file.name.toLowerCase().endsWith(end))) { junctions.read(file, headers); return; }
    notice(tr("Reading {file} \u2026", { file: file.name }));
    try {
      const message = await give("open", file, { headers, most: scene().mostBytes.plan });
      notice(tr("Opened: {names}.", { names: message.opened.join(", ") }));
    } catch (error) {
      notice(error.message); // it begins with the file's name
    }
  }
  find("open").addEventListener("click", () => find("open-file").click());
  find("open-file").addEventListener("change", (event) => { const [file] = event.target.files; if (file) open(file); event.target.value = ""; });
  document.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("dropping"); });
  document.addEventListener("dragleave", (event) => { if (!event.relatedTarget) document.body.classList.remove("dropping"); });
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    const files = [...event.dataTransfer.files], [file] = files;
    if (!file) return;
    if (files.some((one) => one.type.startsWith("image/") || IS_WORLD.test(one.name)) && !PLANS.some((end) => file.name.endsWith(end))) takeImage(files);
    else open(file);
  });

  for (const [id, path, name] of [["make-report", "report.zip", tr("The report")], ["make-sheet", "sheet.pdf", tr("The mounting sheet")]]) {
    find(id).addEventListener("click", async () => {
      find(id).disabled = true;
      notice(tr("{what} is being prepared \u2026", { what: name }));
      try {
        const address = URL.createObjectURL(await ask(path));
        const link = element("a", { href: address, download: path });
        link.click();
        setTimeout(() => URL.revokeObjectURL(address), 60000);
        notice(tr("{what} is in your downloads: {file}.", { what: name, file: path }));
      } catch (error) {
        notice(`${name}: ${error.message}`);
      } finally {
        find(id).disabled = false;
      }
    });
  }
  for (const id of ["save-layout", "save-plan"]) {
    find(id).addEventListener("click", (event) => {
      if (id === "save-layout" && !state()?.units.length) { event.preventDefault(); notice(tr("Nothing is mounted yet: there is no layout to save.")); } else saved();
    });
  }

  // ---------- the background image

  let image = null, preview = "", turn = 1; // a file that was chosen, or null: the one that is laid
  function preparePreview(address) {
    if (preview) URL.revokeObjectURL(preview);
    preview = address.startsWith("blob:") ? address : "";
    Object.assign(find("image-shown"), { src: address, hidden: false });
  }
  find("image-shown").addEventListener("error", () => { find("image-text").textContent = tr("The browser cannot show this image."); find("image-shown").hidden = true; image = null; });
  function showImage(file) {
    image = file;
    preparePreview(URL.createObjectURL(file));
    find("image-text").textContent = tr("Click the first point in the image.");
    turn = 1;
    if (!find("image-dialog").open) find("image-dialog").showModal();
  }
  find("background").addEventListener("click", () => find("image-dialog").showModal());
  const IS_WORLD = /\.(pgw|jgw|wld|pngw|jpgw|tfw)$/i, IS_TIFF = /\.tiff?$/i;
  async function laidByItself(file, world) {
    const numbers = world ? (await world.text()).trim().split(/\s+/).join(" ") : "";
    find("image-text").textContent = tr("Placing {file} on the plan \u2026", { file: file.name });
    const headers = { "X-File-Name": encodeURIComponent(file.name), "X-World": numbers.slice(0, 500), "X-Crs": find("image-crs").value };
    try {
      await give("background", file, { headers, most: scene().mostBytes.map });
      find("image-text").textContent = "";
      find("image-dialog").close();
    } catch (error) {
      find("image-text").textContent = error.message;
    }
  }
  function takeImage(files) {
    const world = files.find((file) => IS_WORLD.test(file.name)), file = files.find((one) => one !== world);
    if (!file) { if (world) find("image-text").textContent = tr("Choose the image together with its world file."); return; }
    if (world || IS_TIFF.test(file.name)) { if (!find("image-dialog").open) find("image-dialog").showModal(); laidByItself(file, world); } else showImage(file);
  }
  find("image-file").addEventListener("change", (event) => { takeImage([...event.target.files]); event.target.value = ""; });
  find("opacity").addEventListener("input", (event) => map.fade(event.target.valueAsNumber / 100));
  find("image-shown").addEventListener("click", (event) => {
    const target = event.target, box = target.getBoundingClientRect();
    find(`x${turn}`).value = ((event.clientX - box.left) / box.width * target.naturalWidth).toFixed(1);
    find(`y${turn}`).value = ((event.clientY - box.top) / box.height * target.naturalHeight).toFixed(1);
    find("image-text").textContent = tr("Point {n} of the image is chosen.", { n: turn });
    turn = 3 - turn;
  });
  document.querySelectorAll("[data-pick]").forEach((button) => button.addEventListener("click", () => {
    const which = button.dataset.pick;
    find("image-dialog").close();
    notice(tr("Click the same place on the plan."));
    map.pick(([x, y]) => {
      find(`east${which}`).value = (x / 100).toFixed(2);
      find(`north${which}`).value = (y / 100).toFixed(2);
      notice("");
      find("image-dialog").showModal();
    });
  }));
  const POINT_FIELDS = ["x", "y", "east", "north"];
  find("image-lay").addEventListener("click", async () => {
    const numbers = [1, 2].map((n) => POINT_FIELDS.map((name) => find(`${name}${n}`).valueAsNumber));
    const { src, naturalWidth, naturalHeight, hidden } = find("image-shown");
    if (hidden || !naturalWidth || !numbers.flat().every(Number.isFinite)) { find("image-text").textContent = tr("Choose an image and enter all eight numbers."); return; }
    const points = numbers.map(([x_px, y_px, east_m, north_m]) => ({ x_px, y_px, east_m, north_m }));
    try {
      const content = image || await (await fetch(src)).blob();
      await give("background", content, { headers: { "X-Points": JSON.stringify({ width_px: naturalWidth, height_px: naturalHeight, points }) }, most: scene().mostBytes.image });
      find("image-dialog").close();
    } catch (error) {
      find("image-text").textContent = error.message;
    }
  });
  find("image-drop").addEventListener("click", async () => {
    await give("background", "").catch((error) => notice(error.message));
    find("image-dialog").close();
  });

  // What is laid, by whichever browser.
  function readBackground(message) {
    find("opacity-row").hidden = !message.address;
    if (!message.address) {
      map.showImage("");
      return;
    }
    map.showImage(message.address, message.size, message.points.map(([x, y, east, north]) => [[x, y], [100 * east, 100 * north]]));
    if (find("image-dialog").open) return;
    image = null;
    preparePreview(message.address);
    message.points.forEach((point, index) => POINT_FIELDS.forEach((name, column) => { find(`${name}${index + 1}`).value = point[column]; }));
  }

  find("show-help").addEventListener("click", () => find("help-dialog").showModal());
  return { junctions, showRun, readBackground, showHelp: () => find("help-dialog").showModal() };
}
