// Pictures of a page: a slider over small images, and marks by the fate of each observation in a run.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("pictures-data").textContent);
  const by = (name) => document.getElementById(`pictures-${name}`);
  const [run, slider, time, marks, image, overlay, legend] =
    ["run", "slider", "time", "marks", "image", "overlay", "legend"].map(by);
  const svg = "http://www.w3.org/2000/svg";
  const radius = Math.max(data.width / 220, 1.5);

  // A disc for what was fused, a cross for what was left out, a square for what was held out, else a ring.
  const mark = (fate, x, y, r) => {
    const crossed = `M${x - r} ${y - r}L${x + r} ${y + r}M${x - r} ${y + r}L${x + r} ${y - r}`;
    const square = `M${x - r} ${y - r}h${2 * r}v${2 * r}h${-2 * r}z`;
    const made = document.createElementNS(svg, fate === "c" || fate === "h" ? "path" : "circle");
    if (fate === "c" || fate === "h") made.setAttribute("d", fate === "c" ? crossed : square);
    else for (const [key, value] of Object.entries({ cx: x, cy: y, r })) made.setAttribute(key, value);
    made.setAttribute("class", `fate fate-${fate}`);
    return made;
  };

  const draw = () => {
    const shown = data.pictures[Number(slider.value)];
    const fates = shown.fate[run.value] || "";
    image.src = `data:image/jpeg;base64,${shown.jpeg}`;
    image.alt = `Left image of frame ${shown.frame}`;
    time.textContent = `${shown.time.toFixed(2)} s, frame ${shown.frame}`;
    const counts = {};
    const drawn = [...fates].map((fate, k) => {
      counts[fate] = (counts[fate] || 0) + 1;
      return mark(fate, shown.at[2 * k], shown.at[2 * k + 1], radius);
    });
    overlay.replaceChildren(...drawn);
    const told = Object.entries(data.fates).map(([fate, what]) => `${counts[fate] || 0} ${what}`);
    overlay.setAttribute("aria-label", `Observations in ${run.value}: ${told.join(", ")}`);
    legend.replaceChildren(
      ...Object.entries(data.fates).map(([fate, what]) => {
        const item = document.createElement("li");
        const key = document.createElementNS(svg, "svg");
        key.setAttribute("viewBox", "-5 -5 10 10");
        key.setAttribute("aria-hidden", "true");
        key.append(mark(fate, 0, 0, 3));
        item.append(key, ` ${counts[fate] || 0} ${what}`);
        return item;
      }),
    );
  };

  for (const name of data.runs) run.add(new Option(name, name));
  slider.max = String(data.pictures.length - 1);
  overlay.setAttribute("viewBox", `0 0 ${data.width} ${data.height}`);
  image.width = data.width;
  image.height = data.height;
  slider.addEventListener("input", draw);
  run.addEventListener("change", draw);
  marks.addEventListener("click", () => {
    const shown = marks.getAttribute("aria-pressed") !== "true";
    marks.setAttribute("aria-pressed", String(shown));
    overlay.toggleAttribute("hidden", !shown);
    overlay.style.display = shown ? "" : "none";
  });
  by("missing").hidden = true;
  by("body").hidden = false;
  draw();
})();
