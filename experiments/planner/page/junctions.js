// Another junction or scene: chosen on the map, read and cut out while the page tells how far that is.

import { openJunctionMap } from "./junction_map.js";
import { ask, give } from "./line.js";
import { element } from "./shared.js";
import { number, tr, trn } from "./words.js";

const find = (id) => document.getElementById(id);
const LEAST_S = 1; // of a step, before its time left is told
const STOPPED = 409;

export function createJunctions({ notice, scene, hasUnits, send }) {
  let chooser = null, chosen = null, isBusy = false, last = null;
  let begun = 0, step = { name: "", begun: 0, done: 0, total: 0 }, timer = 0;

  // ---------- how far it is

  function tell() {
    const now = performance.now(), past = (now - begun) / 1000, { name, done, total } = step;
    const values = { step: name, n: done, all: total, seconds: number(past, 0) };
    const stepPast = (now - step.begun) / 1000, left = number(stepPast / done * (total - done), 0);
    find("map-doing").textContent = !name ? tr("Starting: {seconds} s so far.", values)
      : !total ? tr("{step}: {seconds} s so far.", values)
      : done && stepPast > LEAST_S ? tr("{step}, {n} of {all}: {seconds} s so far; this step takes about {left} s more.", { ...values, left })
      : tr("{step}, {n} of {all}: {seconds} s so far.", values);
    const bar = find("map-bar");
    if (total) Object.assign(bar, { max: total, value: done });
    else bar.removeAttribute("value");
  }
  function busy(isNow) {
    isBusy = isNow;
    clearInterval(timer);
    find("map-progress").hidden = !isNow;
    find("map-take").disabled = isNow || !chosen;
    find("map-choice").inert = isNow;
    if (!isNow) return;
    begun = performance.now();
    step = { name: "", begun, done: 0, total: 0 };
    timer = setInterval(tell, 500);
    tell();
  }
  function doing({ stage, done, total }) {
    if (!isBusy || !stage) return;
    step = { name: stage, begun: stage === step.name ? step.begun : performance.now(), done, total };
    tell();
  }
  const stop = () => { if (isBusy) send({ do: "cancel-opening" }); };
  find("map-stop").addEventListener("click", stop);
  find("map-dialog").addEventListener("close", stop);

  // ---------- what there is to choose from

  function open() {
    if (!find("map-dialog").open) find("map-dialog").showModal();
  }
  function say(text) {
    find("map-text").textContent = text;
  }

  function offer(message) {
    find("another-junction").hidden = message.isScene;
    const n = message.junctions.length;
    const has = message.isScene ? tr("{map} is the scene {name}.", message) : trn("{map} has {n} junction.", "{map} has {n} junctions.", n, message);
    const leads = tr("The plan there starts with no sensors; Undo returns to the plan at {scene}.", { scene: scene().title });
    say(hasUnits() ? `${has} ${leads}` : has);
    open();
    if (message !== last) build(message);
    last = message;
    find("map-take").disabled = !chosen;
  }
  function build(message) {
    const holder = find("map-choice");
    holder.hidden = message.isScene;
    holder.replaceChildren();
    chosen = message.isScene ? { id: "", name: message.name } : null;
    if (message.isScene) return;
    holder.innerHTML = message.chooser; // our own template, in which all texts of the map are escaped
    chooser = openJunctionMap(holder, (junction) => { chosen = junction; find("map-take").disabled = isBusy; });
    if (chooser.first() >= 0) chooser.choose(chooser.first());
  }

  // What is asked of the server, while the page tells how far it is; undefined: it was given up, or went wrong.
  async function carryOut(request, onError = say) {
    busy(true);
    try {
      return await request();
    } catch (error) {
      if (error.status === STOPPED) find("map-dialog").close();
      else onError(error.message);
      return undefined;
    } finally {
      busy(false);
    }
  }
  function fail(text) {
    find("map-dialog").close();
    notice(text);
  }

  function forget() {
    find("map-choice").replaceChildren();
    [chosen, last] = [null, null];
  }

  // A file with a map or a scene.
  async function read(file, headers) {
    forget();
    say(tr("Reading {file} \u2026", { file: file.name }));
    open();
    const message = await carryOut(() => give("open", file, { headers, most: scene().mostBytes.map }), fail);
    if (!message) return;
    offer(message);
    if (message.isScene && !hasUnits()) await take();
  }

  async function take() {
    const asked = chosen;
    if (find("map-choice").hidden) say(tr("Reading the scene \u2026"));
    const message = await carryOut(() => give("import", asked.id), (text) => {
      say(text);
      if (!asked.id) return;
      chooser.refuse(asked.id, text);
      chosen = null;
    });
    if (!message) return;
    find("map-dialog").close();
    if (!find("notice").textContent) notice(tr("The scene is {name}.", { name: message.scene }));
  }
  find("map-take").addEventListener("click", take);

  find("another-junction").addEventListener("click", async () => {
    if (last && !last.isScene && [last.map, ""].includes(scene().map)) { offer(last); return; }
    forget();
    say(tr("Reading {file} \u2026", { file: scene().map }));
    open();
    const message = await carryOut(() => ask("junctions"));
    if (message) offer(message);
  });

  // The map that the scene is of, if it was named, and which junction of it was taken.
  function readScene({ map, assumed, title }) {
    find("another-junction").hidden = !map;
    const isAssumed = Boolean(map && assumed.length);
    find("junction-note").hidden = !isAssumed;
    find("junction-note").textContent = isAssumed ? tr("{junction} in {map}: {assumed}.", { junction: title, map, assumed: assumed[0] }) : "";
  }

  return { read, doing, readScene };
}
