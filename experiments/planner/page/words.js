// The page's language. A sentence stands here in English, whole, as a literal, with names in braces
// for what is put in: the server collects all such literals and sends their translations with the
// page (languages/de/*.po has them). In index.html.j2 the same name does the same, as in the report.

import { say } from "./shared.js";

const LANGUAGE = document.documentElement.lang;

// "{n} of {all} units", { n, all } in the page's language; values are put in as they are.
export const tr = say;

// As tr, in the form for one or for many; "{n}" is the number itself.
export const trn = (one, many, n, values) => say(n === 1 ? one : many, { n, ...values });

// A number with so many digits behind the page's decimal sign; without any, as many as it needs.
export function number(value, digits) {
  const style = { minimumFractionDigits: digits ?? 0, maximumFractionDigits: digits ?? 6, useGrouping: false };
  return new Intl.NumberFormat(LANGUAGE, style).format(value);
}

export const bytes = (value) => value.toLocaleString(LANGUAGE);
