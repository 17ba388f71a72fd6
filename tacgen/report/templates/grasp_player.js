"use strict";
(() => {
  const views = [...document.querySelectorAll(".view")];
  const slider = document.querySelector(".controls input[type=range]");
  const play = document.getElementById("play");
  const cursor = document.querySelector(".cursor");
  const curves = document.querySelector(".curves");
  const toggles = [...document.querySelectorAll(".controls input[type=checkbox]")];
  let timer = 0;

  function show(place) {
    const k = Math.max(0, Math.min(FRAMES.length - 1, place));
    slider.value = k;
    document.querySelector(".controls output").textContent = `${FRAMES[k].text}`;
    cursor.style.left = `${100 * FRAMES[k].at}%`;
    views.forEach((view, pad) => {
      const frame = PADS[pad][k];
      view.querySelector("img").src = frame.image;
      for (const name of ["moved", "normal", "shear"]) {
        view.querySelector(`.${name}`)?.setAttribute("d", frame[name]);
      }
      const caption = view.parentElement.querySelector("span");
      caption.textContent = frame.text;
    });
  }

  function stop() {
    clearInterval(timer);
    timer = 0;
    play.textContent = "▶";
  }

  const step = (by) => { stop(); show(+slider.value + by); };
  document.getElementById("back").addEventListener("click", () => step(-1));
  document.getElementById("next").addEventListener("click", () => step(1));
  slider.addEventListener("input", () => step(0));
  play.addEventListener("click", () => {
    if (timer) { stop(); return; }
    play.textContent = "❚❚";
    timer = setInterval(() => show((+slider.value + 1) % FRAMES.length), 300);
  });
  for (const toggle of toggles) {
    const apply = () => {
      for (const part of document.querySelectorAll(`.view .${toggle.name}`)) part.toggleAttribute("hidden", !toggle.checked);
    };
    toggle.addEventListener("change", apply);
    apply();
  }
  curves.addEventListener("click", (event) => {
    const box = curves.getBoundingClientRect();
    const at = (event.clientX - box.left) / box.width;
    const distances = FRAMES.map((frame) => Math.abs(frame.at - at));
    stop();
    show(distances.indexOf(Math.min(...distances)));
  });
  addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: -1, ArrowRight: 1, Home: -FRAMES.length, End: FRAMES.length };
    if (!(event.key in moves) || event.target === slider || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    step(moves[event.key]);
  });
  show(+slider.value);
})();
