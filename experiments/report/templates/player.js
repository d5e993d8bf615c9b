// Chooses runs and frames; plan, heatmap, slider and words follow.

function startPlayer(data) {
  const find = (id) => document.getElementById(id);
  const [choice, play, speed, slider, timeline, status] =
    ["player-run", "player-play", "player-speed", "player-frame", "player-timeline", "player-status"].map(find);
  const { parties, runs } = data;
  const fused = parties.findIndex((party) => party.kind === "rsu_all");
  runs.forEach((run) => { run.detected = unpackBits(run.bits, parties.length, run.time.length); });
  find("watch").hidden = false;

  const plan = createPlan(find("player-plan"), data);
  const heatmap = createHeatmap(find("player-heatmap"), parties, (frame) => { pause(); show(frame); });
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  let run = runs[data.first], frame = 0, timer = 0, startedAt = 0, startedFrom = 0;

  fillKey(find("player-key"), data);
  let group = null;
  runs.forEach((item, index) => {
    if (!group || group.label !== item.group) group = element("optgroup", { label: item.group }, choice);
    element("option", { value: index, text: say(item.avoided[fused] ? "{run}: avoided" : "{run}: not avoided", { run: item.title }) }, group);
  });

  function chooseRun(index) {
    pause();
    run = runs[index];
    slider.max = run.time.length - 1;
    plan.showRun(run);
    heatmap.showRun(run);
    frame = lastFrame(run);
    markTimes();
    layOut();
    if (find("player-details").open) fillTable(find("player-table"), parties, run);
  }

  function layOut() {
    plan.layOut();
    heatmap.layOut();
    show(frame);
  }

  function markTimes() {
    timeline.querySelectorAll(".mark").forEach((mark) => mark.remove());
    for (const [name, ms, text] of [
      ["last", run.last, "last moment to brake {time} s"],
      ["confirmed", run.confirmed[fused], "confirmed by all RSUs {time} s"],
      ["onset", run.onset[fused], "car would brake {time} s"],
    ]) {
      const share = shareOf(run, ms);
      if (share === null) continue;
      const mark = element("div", { class: `mark ${name}${share > 0.5 ? " late" : ""}` }, timeline);
      mark.style.left = `calc(7px + (100% - 16px) * ${share.toFixed(5)})`;
      element("span", { text: say(text, { time: seconds(ms) }) }, mark);
    }
  }

  function timeLeft(ms) {
    if (run.last === null) return say("No braking avoids the impact in this run.");
    const left = run.last - ms;
    if (left >= 0) return say("{time} s left until the last moment to brake.", { time: seconds(left) });
    return say("The last moment to brake was {time} s ago.", { time: seconds(-left) });
  }

  function whoDetects() {
    const units = parties.filter((party) => party.kind === "unit");
    const names = units.filter((_, index) => run.detected[index + 1][frame]).map((party) => party.name);
    const [n, all, byCar] = [names.length, units.length, run.detected[0][frame]];
    if (!n) return say(byCar ? "No unit detects; the car itself does." : "No unit detects; the car itself does not.");
    const values = { n, all, names: names.join(", ") };
    if (n > 12) return say(byCar ? "{n} of {all} units detect; the car itself does." : "{n} of {all} units detect; the car itself does not.", values);
    if (n > 1) return say(byCar ? "{n} of {all} units detect ({names}); the car itself does." : "{n} of {all} units detect ({names}); the car itself does not.", values);
    return say(byCar ? "{n} of {all} units detects ({names}); the car itself does." : "{n} of {all} units detects ({names}); the car itself does not.", values);
  }

  function confirmation() {
    const [confirmed, onset, now] = [run.confirmed[fused], run.onset[fused], run.time[frame]];
    if (confirmed === null) return say("All RSUs together never confirm the road user.");
    if (confirmed > now) return say("Not confirmed yet.");
    if (onset === null) return say("Confirmed at {time} s, but lost again: no track is alive at the last moment.", { time: seconds(confirmed) });
    const values = { time: seconds(confirmed), onset: seconds(onset), spare: seconds(Math.abs(run.last - onset)) };
    if (run.last === null) return say("Confirmed by all RSUs at {time} s; with them the car would brake from {onset} s on.", values);
    if (run.last >= onset) return say("Confirmed by all RSUs at {time} s; with them the car would brake from {onset} s on: {spare} s to spare.", values);
    return say("Confirmed by all RSUs at {time} s; with them the car would brake from {onset} s on: {spare} s too late.", values);
  }

  function show(next) {
    frame = Math.max(0, Math.min(run.time.length - 1, next));
    const ms = run.time[frame];
    slider.value = frame;
    slider.setAttribute("aria-valuetext", `${seconds(ms)} s`);
    plan.showFrame(frame);
    heatmap.showFrame(frame);
    status.replaceChildren();
    element("strong", { text: `${ms === 0 ? say("Impact.") : say("{time} s.", { time: seconds(ms) })} ` }, status);
    status.append(`${timeLeft(ms)} ${whoDetects()} ${confirmation()}`);
  }

  function pause() {
    cancelAnimationFrame(timer);
    timer = 0;
    play.textContent = calm.matches ? say("Next frame") : say("Play");
    status.setAttribute("aria-live", "polite");
  }

  function begin() {
    play.textContent = say("Pause");
    status.setAttribute("aria-live", "off"); // not a sentence ten times a second
    if (frame >= run.time.length - 1) show(0);
    [startedAt, startedFrom] = [performance.now(), run.time[frame]];
    timer = requestAnimationFrame(advance);
  }

  function advance(now) {
    const ms = startedFrom + Math.max(0, now - startedAt) * Number(speed.value);
    let next = frame;
    while (next < run.time.length - 1 && run.time[next + 1] <= ms) next += 1;
    if (next !== frame) show(next);
    if (frame >= run.time.length - 1) pause();
    else timer = requestAnimationFrame(advance);
  }

  choice.addEventListener("change", () => chooseRun(Number(choice.value)));
  slider.addEventListener("input", () => { pause(); show(Number(slider.value)); });
  play.addEventListener("click", () => {
    if (timer) pause();
    else if (calm.matches) show(frame >= run.time.length - 1 ? 0 : frame + 1); // nothing moves by itself
    else begin();
  });
  speed.addEventListener("change", () => { [startedAt, startedFrom] = [performance.now(), run.time[frame]]; });
  calm.addEventListener("change", pause);
  find("player-closer").addEventListener("click", () => plan.zoomBy(1));
  find("player-farther").addEventListener("click", () => plan.zoomBy(-1));
  find("player-last").addEventListener("click", () => { pause(); show(lastFrame(run)); });
  find("player-details").addEventListener("toggle", () => fillTable(find("player-table"), parties, run));
  let width = find("player").clientWidth;
  window.addEventListener("resize", () => {
    if (find("player").clientWidth === width) return;
    width = find("player").clientWidth;
    layOut();
  });
  let before = 0;
  window.addEventListener("beforeprint", () => { pause(); before = frame; show(lastFrame(run)); });
  window.addEventListener("afterprint", () => show(before));
  pause();
  choice.value = data.first;
  chooseRun(data.first);
}
