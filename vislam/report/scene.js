// The 3-D scene: paths, maps, and at one time of the drive each estimator's pose with its uncertainty.
"use strict";
(() => {
  const element = (id) => document.getElementById(id);
  const plot = element("scene-plot");
  const probe = document.createElement("canvas");
  const context = probe.getContext("webgl2") || probe.getContext("webgl");
  if (!context || typeof DecompressionStream === "undefined") {
    element("scene-missing").hidden = false;
    return;
  }
  context.getExtension("WEBGL_lose_context")?.loseContext();

  const data = JSON.parse(element("scene-data").textContent);
  const decode = (text) => {
    const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  };
  const columns = (values) =>
    [0, 1, 2].map((axis) => values.filter((_, index) => index % 3 === axis));
  // A variable is resolved by the browser only where a property uses it.
  const colour = (variable) => {
    plot.style.color = `var(${variable})`;
    const found = getComputedStyle(plot).color;
    plot.style.color = "";
    return found;
  };
  const runColour = (index) => colour(`--c${runs[index].colour}`);

  // Where the slider stops: these frames, at these times.
  const [stops, stamp] = [decode(data.stop), decode(data.stamp)];
  const runs = data.runs.map((run) => ({
    name: run.name,
    colour: run.colour,
    path: columns(decode(run.path)),
    landmarks: columns(decode(run.landmarks)),
    firstSeen: decode(run.first_seen),
    frame: decode(run.frame),
    position: decode(run.position),
    attitude: decode(run.attitude),
    semiAxes: decode(run.semi_axes),
  }));
  const spans = data.high.map((value, axis) => value - data.low[axis]);
  const extent = Math.max(...spans);
  // The library's own "data" takes the proportions of what is drawn, not those of the box that is shown.
  const proportions = Object.fromEntries(["x", "y", "z"].map((name, axis) => [name, (1.6 * spans[axis]) / extent]));
  const axisLength = 0.02 * extent;
  const circle = Array.from({ length: 33 }, (_, index) => (2 * Math.PI * index) / 32);

  // Lines of a pose: its three body axes, and the three principal ellipses of its ellipsoid.
  const poseLines = (run, frame, magnified) => {
    const lines = [[], [], []];
    const at = (axis) => run.position[3 * frame + axis];
    const add = (offset) => lines.forEach((line, axis) => line.push(at(axis) + offset(axis)));
    const lift = () => lines.forEach((line) => line.push(null));
    for (let body = 0; body < 3; body += 1) {
      add(() => 0);
      add((axis) => axisLength * run.attitude[9 * frame + 3 * axis + body]);
      lift();
    }
    const semi = (axis, which) => magnified * run.semiAxes[9 * frame + 3 * axis + which];
    if (Number.isNaN(semi(0, 0))) return lines;
    for (const [one, other] of [[0, 1], [1, 2], [2, 0]]) {
      for (const angle of circle) {
        add((axis) => Math.cos(angle) * semi(axis, one) + Math.sin(angle) * semi(axis, other));
      }
      lift();
    }
    return lines;
  };
  // How many of some frames, in increasing order, are not after a frame.
  const upTo = (frames, frame) => {
    let low = 0;
    let high = frames.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (frames[middle] <= frame) low = middle + 1;
      else high = middle;
    }
    return low;
  };

  const slider = element("scene-slider");
  const play = element("scene-play");
  const magnify = element("scene-magnify");
  const last = stops.length - 1;
  slider.max = String(last);
  slider.value = slider.max;

  // What moves, one entry a trace: landmarks of every run, then poses of every run.
  const moving = () => {
    const frame = stops[Number(slider.value)];
    const drawn = [];
    for (const run of runs) {
      const count = upTo(run.firstSeen, frame);
      drawn.push(run.landmarks.map((values) => values.subarray(0, count)));
    }
    for (const run of runs) {
      const row = Math.max(0, upTo(run.frame, frame) - 1);
      drawn.push(poseLines(run, row, Number(magnify.value)));
    }
    return drawn;
  };
  const tell = () => {
    const stop = Number(slider.value);
    const text = `${stamp[stop].toFixed(1)} s, frame ${stops[stop]} of ${data.frames - 1}`;
    element("scene-time").textContent = text;
    slider.setAttribute("aria-valuetext", text);
  };

  const trace = (mode, [x, y, z], options) => ({
    type: "scatter3d", mode, x, y, z, hoverinfo: "skip", ...options,
  });
  const traces = () => {
    const [now, ink] = [moving(), colour("--ink")];
    const made = [];
    runs.forEach((run, index) => made.push(trace("markers", now[index], {
      marker: { size: 1.6, color: runColour(index), opacity: 0.55, line: { width: 0 } },
      name: `map of ${run.name}`, legendgroup: run.name, showlegend: false,
    })));
    runs.forEach((run, index) => made.push(trace("lines", now[runs.length + index], {
      line: { width: 3, color: runColour(index) }, name: `pose of ${run.name}`, legendgroup: run.name, showlegend: false,
    })));
    runs.forEach((run, index) => made.push(trace("lines", run.path, {
      line: { width: 4, color: runColour(index) }, name: run.name, legendgroup: run.name,
    })));
    if (data.reference) {
      made.push(trace("markers", columns(decode(data.reference.position)), {
        marker: { size: 2.2, color: ink, line: { width: 0 } }, name: data.reference.name,
      }));
    }
    return made;
  };
  const axis = (title, index, ink, line) => ({
    title: { text: title }, range: [data.low[index], data.high[index]], color: ink, gridcolor: line,
    zerolinecolor: line, showbackground: false, showspikes: false, nticks: index === 2 ? 3 : 7,
  });
  // Always in perspective: the drawing library loses the traces where a button changes the projection.
  const camera = ([x, y, z], [upX, upY, upZ]) => ({ eye: { x, y, z }, up: { x: upX, y: upY, z: upZ } });
  const views = {
    oblique: camera([-1.1, -1.5, 1.3], [0, 0, 1]),
    above: camera([0, -0.001, 2.1], [0, 1, 0]),
    side: camera([0, -2.2, 0.001], [0, 0, 1]),
  };
  const layout = () => {
    const [ink, line] = [colour("--ink"), colour("--line")];
    const names = ["x [m]", "y [m]", "z [m]"];
    const [x, y, z] = names.map((name, index) => axis(name, index, ink, line));
    return {
      margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "kept", paper_bgcolor: "rgba(0,0,0,0)",
      font: { color: ink, size: 12, family: getComputedStyle(document.body).fontFamily },
      legend: { x: 0, y: 1, bgcolor: "rgba(0,0,0,0)", itemsizing: "constant", tracegroupgap: 0 },
      scene: { xaxis: x, yaxis: y, zaxis: z, aspectmode: "manual", aspectratio: proportions, camera: views.oblique, uirevision: "kept" },
    };
  };
  const settings = { displayModeBar: false, responsive: true, showLink: false };
  const movingTraces = Array.from({ length: 2 * runs.length }, (_, index) => index);

  // One drawing at a time; what is asked for meanwhile is drawn once, afterwards.
  let [busy, asked] = [true, false];
  const update = async () => {
    tell();
    asked = true;
    if (busy) return;
    busy = true;
    while (asked) {
      asked = false;
      const now = moving();
      const [x, y, z] = [0, 1, 2].map((which) => now.map((columnsOf) => columnsOf[which]));
      await Plotly.restyle(plot, { x, y, z }, movingTraces);
    }
    busy = false;
  };
  let timer = 0;
  const stop = () => {
    clearInterval(timer);
    timer = 0;
    play.textContent = "Play";
  };
  const step = () => {
    if (busy) return;
    const next = Number(slider.value) + Math.max(1, Math.round(stops.length / 300));
    slider.value = String(next);
    if (next >= last) stop();
    update();
  };
  play.addEventListener("click", () => {
    if (timer) return stop();
    if (Number(slider.value) === last) slider.value = "0";
    play.textContent = "Pause";
    timer = setInterval(step, 60);
    return undefined;
  });
  slider.addEventListener("input", () => { stop(); update(); });
  magnify.addEventListener("change", update);
  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => Plotly.relayout(plot, { "scene.camera": views[button.dataset.view] }));
  }

  // The wheel is the page's, unless the scene was clicked or reached by the keyboard.
  plot.addEventListener("wheel", (event) => {
    if (!plot.contains(document.activeElement)) event.stopPropagation();
  }, { capture: true });
  plot.addEventListener("pointerdown", () => plot.focus({ preventScroll: true }), { capture: true });
  plot.addEventListener("keydown", (event) => {
    if (event.key === "Escape") document.activeElement.blur();
  });

  // The drawing library is unpacked where it is needed, and not before.
  const unpack = async () => {
    const packed = Uint8Array.from(atob(element("plotly").textContent), (character) => character.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  };

  element("scene-body").hidden = false;
  tell();
  const draw = async () => {
    await unpack();
    await Plotly.newPlot(plot, traces(), layout(), settings);
    busy = false;
    plot.dataset.drawn = "true";
    document.addEventListener("themechange", () => Plotly.react(plot, traces(), layout(), settings));
    if (asked) update();
  };
  // Drawing is slow without a graphics card, so it waits until the scene is about to be seen.
  const watcher = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    watcher.disconnect();
    draw();
  }, { rootMargin: "400px" });
  watcher.observe(plot);
})();
