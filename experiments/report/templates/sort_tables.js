// Every table with heads and several rows is sorted by a press on a head: up, down, as it was.

function makeTablesSortable() {
  const collator = new Intl.Collator(document.documentElement.lang || "en", { numeric: true });
  document.querySelectorAll("table").forEach((table) => {
    const [body] = table.tBodies;
    if (!table.tHead || !body || body.rows.length < 2 || "unsorted" in table.dataset) return;
    if (table.querySelector("[colspan], [rowspan]")) return;
    const original = [...body.rows];
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "sort-head";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const before = head.getAttribute("aria-sort");
        const way = before === "ascending" ? "descending" : before === "descending" ? "none" : "ascending";
        for (const cell of table.tHead.rows[0].cells) cell.removeAttribute("aria-sort");
        if (way !== "none") head.setAttribute("aria-sort", way);
        body.append(...(way === "none" ? original : sortedRows(original, column, way, collator)));
      });
    });
  });
}

function sortedRows(rows, column, way, collator) {
  const cells = rows.map((row) => (row.cells[column] ? row.cells[column].textContent.trim() : ""));
  const filled = cells.filter((text) => text && !isMissing(text));
  const numbers = cells.map(leadingNumber);
  const isNumeric = filled.length > 0 && filled.every((text) => !Number.isNaN(leadingNumber(text)));
  const sign = way === "ascending" ? 1 : -1;
  return rows
    .map((row, index) => ({ row, index, text: cells[index], number: numbers[index] }))
    .sort((a, b) => {
      // What has no value stays at the end, whichever way.
      const gap = (isNumeric ? Number.isNaN(a.number) - Number.isNaN(b.number) : isMissing(a.text) - isMissing(b.text));
      if (gap) return gap;
      const order = isNumeric ? (Number.isNaN(a.number) ? 0 : a.number - b.number) : collator.compare(a.text, b.text);
      return sign * order || a.index - b.index;
    })
    .map((item) => item.row);
}

function isMissing(text) {
  return ["", "-", "\u2013", "\u2014", "never", "none", "n/a", "nan", say("never")].includes(text.toLowerCase());
}

// "1 234.5 m", "-0.3 s", "97 %", "EUR 5", "hit, 0.3 s too late": the number counts, not its unit.
function leadingNumber(text) {
  const points = hasCommas ? text.replace(/\.(?=\d{3}(\D|$))/g, "").replace(/(\d),(?=\d)/g, "$1.") : text;
  const plain = points.replace(/\u2212/g, "-").replace(/(\d)[\u00a0\u2009\u202f, ](?=\d{3}(\D|$))/g, "$1");
  if ([say("HIT, not confirmed"), say("HIT, lost again")].includes(text)) return -Infinity;
  const [late, spare] = ["HIT, {time} s late", "avoided, {time} s"].map((message) => say(message, { time: "\0" }).split("\0")[0]);
  const sign = text.startsWith(late) ? -1 : 1; // too late is less than nothing to spare
  const value = [late, spare].reduce((rest, words) => (rest.startsWith(words) ? rest.slice(words.length) : rest), plain);
  const found = /^(?:[<>\u2264\u2265\u2248\u20ac$#] ?|EUR )?([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)/i.exec(value);
  if (found) return sign * Number(found[1]);
  if (/^[+]?\u221e/.test(plain)) return Infinity;
  if (/^-\u221e/.test(plain)) return -Infinity;
  return NaN;
}
