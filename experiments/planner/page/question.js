// What is driven, and how it is seen and weighed: controls whose change has the runs laid anew.

import { element } from "./shared.js";
import { tr } from "./words.js";

const find = (id) => document.getElementById(id);
const CARS = { blind: tr("act on the units' messages alone"), see: tr("look with their own sensors, too") };
const WEATHERS = { day: tr("day"), night: tr("night"), rain: tr("rain"), fog: tr("fog") };

export function createQuestion({ send }) {
  let told = null;

  function fill(id, words, now, textOf = (word) => word) {
    find(id).replaceChildren(...words.map((word) => element("option", { value: word, text: textOf(word) })));
    find(id).value = now;
  }

  // The session's question, or the one it goes on with where another could not be had.
  function read(message) {
    told = message;
    const { now, choices } = told;
    fill("ask-detector", choices.detector, now.detector);
    fill("ask-weights", choices.weights, now.weights, (word) => word || tr("default ({weights})", { weights: told.defaultWeights }));
    fill("ask-cars", choices.cars, now.cars, (word) => CARS[word] ?? word);
    find("ask-cases-known").replaceChildren(...choices.cases.map((value) => element("option", { value })));
    find("ask-cases").value = now.cases;
    find("ask-vam").value = Number((100 * now.vam_rate).toFixed(2));
    const on = now.weather.split(",");
    if (find("ask-weather").children.length !== choices.weather.length + 1) {
      find("ask-weather").append(...choices.weather.map((word) => {
        const label = element("label", {});
        const box = element("input", { type: "checkbox", value: word }, label);
        label.append(` ${WEATHERS[word] ?? word}`);
        box.addEventListener("change", () => ask("weather", weathers().join(",")));
        return label;
      }));
    }
    boxes().forEach((box) => { box.checked = on.includes(box.value); });
    find("question-command").textContent = told.command;
    find("question-now").textContent = tr("cases {cases}; {weather}; detector {detector}", { ...now, weather: on.map((word) => WEATHERS[word] ?? word).join(", ") });
  }

  const boxes = () => [...find("ask-weather").querySelectorAll("input")];
  const weathers = () => boxes().filter((box) => box.checked).map((box) => box.value);
  function ask(name, value) {
    send({ do: "question", [name]: value });
  }
  for (const name of ["cases", "detector", "weights", "cars"]) find(`ask-${name}`).addEventListener("change", (event) => ask(name, event.target.value.trim()));
  find("ask-vam").addEventListener("change", (event) => { if (Number.isFinite(event.target.valueAsNumber)) ask("vam_rate", event.target.valueAsNumber / 100); });
  find("question-form").addEventListener("submit", (event) => event.preventDefault());

  return {
    read,
    refused() { if (told) read(told); }, // what was asked for cannot be: the controls say what is so
    doing(text) {
      find("question-doing").textContent = text ? tr("Recomputing the runs ({step}); everything stays as before until then.", { step: text }) : "";
      find("question-form").setAttribute("aria-busy", String(Boolean(text)));
    },
    meaning: () => told?.meaning ?? "",
  };
}
