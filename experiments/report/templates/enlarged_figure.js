// A press on a figure, or on the button below it, shows the picture in all its pixels.

const dialog = document.createElement("dialog");
dialog.className = "enlarged";
const close = document.createElement("button");
close.type = "button";
close.textContent = say("Close");
const holder = document.createElement("div");
holder.className = "scroll";
holder.setAttribute("role", "group");
holder.setAttribute("aria-label", say("Picture in full size"));
dialog.append(close, holder);
document.body.append(dialog);
close.addEventListener("click", () => dialog.close());
dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });

document.querySelectorAll("figure").forEach((figure) => {
  const image = figure.querySelector("img");
  const title = figure.querySelector("figcaption strong").textContent;
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = say("Enlarge");
  button.setAttribute("aria-label", say("Enlarge: {title}", { title }));
  const enlarge = () => {
    dialog.setAttribute("aria-label", title);
    holder.replaceChildren(image.cloneNode());
    dialog.showModal();
  };
  button.addEventListener("click", enlarge);
  image.addEventListener("click", enlarge);
  image.style.cursor = "zoom-in";
  figure.querySelector("figcaption").append(button);
});
