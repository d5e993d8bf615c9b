// Boxes with more to the right fade there; those that hold all of it are no stops of the tab key.

function markScrollBox(box) {
  const left = box.scrollWidth - box.clientWidth - box.scrollLeft;
  box.classList.toggle("more-right", left > 2);
  if (box.scrollWidth > box.clientWidth + 1) box.tabIndex = 0;
  else box.removeAttribute("tabindex");
}

const boxes = document.querySelectorAll(".scroll");
const sizes = new ResizeObserver((entries) => entries.forEach((entry) => markScrollBox(entry.target.closest(".scroll"))));
boxes.forEach((box) => {
  box.addEventListener("scroll", () => markScrollBox(box), { passive: true });
  sizes.observe(box); // its size: also when it is unfolded
  [...box.children].forEach((child) => sizes.observe(child)); // what it holds may grow later: pictures, letters
});
