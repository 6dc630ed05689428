"use strict";
// Enlarge a picture; the arrow keys flip between the photo, the rendering and the error of the same view.
const box = document.createElement("dialog");
const image = box.appendChild(document.createElement("img"));
const words = box.appendChild(document.createElement("p"));
document.body.appendChild(box);
let shots = [];
let at = 0;

function show(index) {
  at = (index + shots.length) % shots.length;
  const source = shots[at].querySelector("img");
  image.src = source.src;
  image.alt = source.alt;
  words.textContent = source.alt + "  ·  click or ← → to flip, Esc to close";
}

for (const shot of document.querySelectorAll("button.shot")) {
  shot.addEventListener("click", () => {
    shots = [...shot.parentElement.querySelectorAll("button.shot")];
    show(shots.indexOf(shot));
    box.showModal();
  });
}
box.addEventListener("keydown", (event) => {
  const move = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (move) show(at + move);
});
image.addEventListener("click", () => show(at + 1));
box.addEventListener("click", (event) => {
  if (event.target !== image) box.close();
});
addEventListener("beforeprint", () => {
  for (const part of document.querySelectorAll("details")) part.open = true;
});
