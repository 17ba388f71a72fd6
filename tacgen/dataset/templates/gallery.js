"use strict";
(() => {
  const form = document.getElementById("filters");
  const cards = [...document.querySelectorAll(".card")];
  const byIndex = new Map(POINTS.map((point) => [point.index, point]));
  const SVG = "http://www.w3.org/2000/svg";
  const BOX = { left: 40, right: 410, top: 10, bottom: 196 };

  function make(parent, name, attributes, text) {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    parent.append(node);
    return node;
  }

  function selection() {
    const low = Math.min(+form.low.value, +form.high.value);
    const high = Math.max(+form.low.value, +form.high.value);
    const outcomes = [...form.querySelectorAll("[name=outcome]")];
    return {
      outcomes: new Set(outcomes.filter((box) => box.checked).map((box) => box.value)),
      all: outcomes.length,
      object: form.object.value,
      split: form.split.value,
      picture: form.picture.value,
      low, high,
    };
  }

  function passes(point, chosen) {
    return chosen.outcomes.has(point.outcome)
      && (!chosen.object || point.object === chosen.object)
      && (!chosen.split || point.split === chosen.split)
      && (!chosen.picture || point.shows.includes(chosen.picture))
      && point.force >= FORCES[chosen.low] && point.force <= FORCES[chosen.high];
  }

  // A round step that gives about `count` ticks up to `top`.
  function step(top, count) {
    const raw = Math.max(top, 1e-9) / count;
    const power = 10 ** Math.floor(Math.log10(raw));
    return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= raw);
  }

  function axes(svg, xMax, yMax, xLabel, yLabel, finest = 0) {
    svg.replaceChildren();
    const x = (value) => BOX.left + (BOX.right - BOX.left) * value / xMax;
    const y = (value) => BOX.bottom - (BOX.bottom - BOX.top) * value / yMax;
    for (let tick = 0, by = Math.max(finest, step(yMax, 4)); tick <= yMax * 1.0001; tick += by) {
      make(svg, "line", { class: "axis", x1: BOX.left, x2: BOX.right, y1: y(tick), y2: y(tick) });
      make(svg, "text", { x: BOX.left - 6, y: y(tick) + 4, "text-anchor": "end" }, +tick.toPrecision(6));
    }
    make(svg, "text", { x: BOX.right, y: 226, "text-anchor": "end" }, xLabel);
    make(svg, "text", { x: 10, y: BOX.top + 90, transform: `rotate(-90 10 ${BOX.top + 90})`, "text-anchor": "middle" }, yLabel);
    return { x, y };
  }

  function drawByForce(points) {
    const svg = document.getElementById("by-force");
    // Every force its own column, or twelve equal ranges where there are more.
    const few = FORCES.length <= 12;
    const low = FORCES[0], span = (FORCES.at(-1) - low) || 1;
    const count = few ? FORCES.length : 12;
    const bins = Array.from({ length: count }, () => ({}));
    for (const point of points) {
      const bin = few ? FORCES.indexOf(point.force) : Math.min(11, Math.floor(12 * (point.force - low) / span));
      bins[bin][point.outcome] = (bins[bin][point.outcome] || 0) + 1;
    }
    const tallest = Math.max(1, ...bins.map((bin) => Object.values(bin).reduce((a, b) => a + b, 0)));
    const { y } = axes(svg, count, tallest, "gripping force (N)", "grasps", 1);
    const width = (BOX.right - BOX.left) / count;
    bins.forEach((bin, place) => {
      let base = 0;
      for (const name of Object.keys(OUTCOMES)) {
        if (!bin[name]) continue;
        const bar = make(svg, "rect", {
          class: `mark ${name}`, x: BOX.left + place * width + width * .12, width: width * .76,
          y: y(base + bin[name]), height: y(base) - y(base + bin[name]),
        });
        make(bar, "title", {}, `${bin[name]} ${OUTCOMES[name]}`);
        base += bin[name];
      }
      const force = few ? FORCES[place] : low + span * (place + .5) / 12;
      make(svg, "text", { x: BOX.left + (place + .5) * width, y: 211, "text-anchor": "middle" }, +force.toPrecision(3));
    });
  }

  function drawContactForce(points) {
    const svg = document.getElementById("contact-force");
    const executed = points.filter((point) => point.outcome !== "not_executed");
    if (!executed.length) {
      svg.replaceChildren();
      make(svg, "text", { x: 210, y: 115, "text-anchor": "middle" }, "none of the selected grasps was executed");
      return;
    }
    const xMax = Math.max(1, ...executed.map((point) => point.normal)) * 1.05;
    const yMax = Math.max(.1, ...executed.map((point) => point.shear)) * 1.08;
    const { x, y } = axes(svg, xMax, yMax, "normal force at the grasp (N)", "largest shear force (N)");
    for (let tick = 0, by = step(xMax, 6); tick <= xMax; tick += by) {
      make(svg, "text", { x: x(tick), y: 211, "text-anchor": "middle" }, +tick.toPrecision(6));
    }
    for (const point of executed) {
      const dot = make(svg, "circle", { class: `mark ${point.outcome}`, r: 4, cx: x(Math.max(0, point.normal)), cy: y(point.shear), "data-index": point.index });
      make(dot, "title", {}, `#${point.index} ${point.object}: ${OUTCOMES[point.outcome]}`);
    }
  }

  function remember(chosen) {
    const state = new URLSearchParams();
    if (chosen.outcomes.size < chosen.all) state.set("outcome", [...chosen.outcomes].join(","));
    for (const key of ["object", "split", "picture"]) if (chosen[key]) state.set(key, chosen[key]);
    if (chosen.low > 0) state.set("low", FORCES[chosen.low]);
    if (chosen.high < FORCES.length - 1) state.set("high", FORCES[chosen.high]);
    for (const key of ["difference", "motion"]) if (form[key]?.checked) state.set(key, "1");
    const hash = state.toString();
    if (hash !== location.hash.slice(1)) history.replaceState(null, "", hash ? `#${hash}` : location.pathname + location.search);
  }

  function recall() {
    const state = new URLSearchParams(location.hash.slice(1));
    // label=1, 0 or -1 is short for the outcomes that have that label.
    const labels = { 1: ["success"], 0: ["translational_slip", "rotational_slip", "failure"], "-1": ["not_executed"] };
    const wanted = state.has("label") ? labels[state.get("label")] || [] : state.has("outcome") ? state.get("outcome").split(",") : null;
    for (const box of form.querySelectorAll("[name=outcome]")) box.checked = !wanted || wanted.includes(box.value);
    for (const key of ["object", "split", "picture"]) form[key].value = state.get(key) || "";
    const nearest = (force, otherwise) => force === null ? otherwise
      : FORCES.reduce((best, value, place) => Math.abs(value - force) < Math.abs(FORCES[best] - force) ? place : best, 0);
    form.low.value = nearest(state.get("low"), 0);
    form.high.value = nearest(state.get("high"), FORCES.length - 1);
    for (const key of ["difference", "motion"]) if (form[key]) form[key].checked = state.has(key);
  }

  function apply() {
    const chosen = selection();
    const points = POINTS.filter((point) => passes(point, chosen));
    let shown = 0;
    for (const card of cards) {
      card.hidden = !passes(byIndex.get(+card.dataset.index), chosen);
      shown += !card.hidden;
    }
    form.querySelector("output").textContent = `${FORCES[chosen.low]} to ${FORCES[chosen.high]} N`;
    document.getElementById("count").textContent = `${shown} of ${cards.length} shown`;
    document.getElementById("none").hidden = shown > 0;
    document.body.classList.toggle("difference", form.difference.checked);
    document.body.classList.toggle("moving", !!form.motion?.checked);
    drawByForce(points);
    drawContactForce(points);
    remember(chosen);
  }

  const large = document.getElementById("large");
  document.querySelector(".cards").addEventListener("click", (event) => {
    const card = event.target.closest(".pair, .strip") && event.target.closest(".card");
    if (!card) return;
    const copy = card.cloneNode(true);
    copy.removeAttribute("id");
    large.querySelector("div").replaceChildren(copy);
    large.showModal();
  });
  large.addEventListener("click", (event) => {
    if (event.target === large || event.target.tagName === "BUTTON") large.close();
  });
  document.getElementById("contact-force").addEventListener("click", (event) => {
    const card = document.getElementById(`grasp-${event.target.dataset.index}`);
    if (!card) return;
    document.querySelector(".lit")?.classList.remove("lit");
    card.classList.add("lit");
    card.scrollIntoView({ behavior: "smooth", block: "center" });
  });
  form.addEventListener("input", apply);
  form.addEventListener("reset", () => setTimeout(apply));
  form.addEventListener("submit", (event) => event.preventDefault());
  addEventListener("hashchange", () => { recall(); apply(); });
  recall();
  apply();
})();
