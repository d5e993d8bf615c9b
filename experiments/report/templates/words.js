// Words of the scripts in the page's language; English where the page has none.

const WORDS = JSON.parse(document.getElementById("script-words")?.textContent || "{}");
const say = (message, values) =>
  (WORDS[message] || message).replace(/\{(\w+)\}/g, (_, name) => values[name]);
const hasCommas = document.documentElement.lang === "de"; // decimal ones
