// Figures over time are drawn over the distance travelled, and back: along x each point moves to where its time belongs.
"use strict";
(() => {
  const controls = document.getElementById("abscissa");
  const [times, distances] = JSON.parse(document.getElementById("travelled").textContent);
  const figures = [...document.querySelectorAll("svg[data-panels]")];
  if (!figures.length || !times || times.length < 2 || !(distances.at(-1) > 0)) return;

  // Values of a polyline that never falls, in between linear, beyond its ends as steep as over the whole.
  const interpolate = (from, to, value) => {
    const last = from.length - 1;
    const slope = (to[last] - to[0]) / (from[last] - from[0]);
    if (value <= from[0]) return to[0] + (value - from[0]) * slope;
    if (value >= from[last]) return to[last] + (value - from[last]) * slope;
    let [low, high] = [0, last];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (from[middle] <= value) low = middle;
      else high = middle;
    }
    return to[low] + ((value - from[low]) / (from[high] - from[low])) * (to[high] - to[low]);
  };
  const niceStep = (span) => {
    const raw = span / 6;
    const power = 10 ** Math.floor(Math.log10(raw));
    return power * [1, 2, 5, 10].find((factor) => factor * power >= raw);
  };

  // A panel with its x axis: what moves, what it was, and the ticks of either abscissa.
  const panelOf = ([id, left, right, first, last]) => {
    const panel = document.getElementById(id);
    const axis = panel.querySelector('g[id*="matplotlib.axis_1"], g[id*="matplotlib.axis_"]');
    const [from, to] = [first, last].map((time) => interpolate(times, distances, time));
    const place = (distance) => left + ((distance - from) / (to - from)) * (right - left);
    const move = (x) => {
      if (x <= left || x >= right) return x;
      const time = first + ((x - left) / (right - left)) * (last - first);
      return place(interpolate(times, distances, time));
    };
    const parts = [...panel.querySelectorAll("path[d], use[x]")]
      .filter((part) => !part.closest('g[id*="matplotlib.axis_"]'))
      .map((part) => {
        const name = part.tagName === "use" ? "x" : "d";
        return { part, name, time: part.getAttribute(name), distance: null };
      });
    const moved = ({ name, time }) =>
      name === "x"
        ? String(move(Number(time)))
        : time.replace(/([ML])\s*(-?[\d.e+-]+)/g, (_, letter, x) => `${letter}${move(Number(x)).toFixed(2)}`);
    const ticks = [...axis.children].filter((group) => /xtick_\d+$/.test(group.id));
    const clones = [];
    const addTicks = () => {
      const step = niceStep(to - from);
      for (let value = Math.ceil(Math.max(from, 0) / step) * step; value <= to; value += step) {
        const clone = ticks[0].cloneNode(true);
        for (const inner of [clone, ...clone.querySelectorAll("[id]")]) inner.removeAttribute("id");
        for (const mark of clone.querySelectorAll("use")) mark.setAttribute("x", String(place(value)));
        for (const text of clone.querySelectorAll("text")) {
          text.textContent = String(Number(value.toPrecision(6)));
          text.setAttribute("x", String(place(value)));
          text.removeAttribute("transform");
        }
        axis.append(clone);
        clones.push(clone);
      }
    };
    return (which) => {
      for (const item of parts) {
        if (which === "distance" && item.distance === null) item.distance = moved(item);
        item.part.setAttribute(item.name, item[which]);
      }
      if (which === "distance" && !clones.length && ticks.length) addTicks();
      for (const tick of ticks) tick.style.display = which === "time" ? "" : "none";
      for (const clone of clones) clone.style.display = which === "time" ? "none" : "";
    };
  };
  const labels = figures.flatMap((figure) =>
    [...figure.querySelectorAll("text")].filter((text) => text.textContent === "time [s]"));

  let panels = null;
  const show = (which) => {
    panels ??= figures.flatMap((figure) => JSON.parse(figure.dataset.panels).map(panelOf));
    for (const panel of panels) panel(which);
    for (const label of labels) label.textContent = which === "time" ? "time [s]" : "distance travelled [m]";
    for (const button of controls.querySelectorAll("button")) {
      button.setAttribute("aria-pressed", String(button.dataset.abscissa === which));
    }
  };
  controls.hidden = false;
  for (const button of controls.querySelectorAll("button")) {
    button.addEventListener("click", () => show(button.dataset.abscissa));
  }
})();
