// A link to a section that is folded opens it before the browser goes there.

const foldedSection = (hash) => (hash ? document.getElementById(hash.slice(1))?.closest("details.part:not([open])") : null);
const openSection = (folded) => {
  folded.open = true;
  folded.scrollIntoView();
};
const openLinked = () => {
  const folded = foldedSection(location.hash);
  if (folded) openSection(folded);
};
document.addEventListener("click", (event) => {
  const folded = foldedSection(event.target.closest("a[href^='#']")?.hash);
  if (folded) openSection(folded);
});
window.addEventListener("hashchange", openLinked);
openLinked();
