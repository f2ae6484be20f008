"use strict";
// Draws every chart of the page in the colours of the reader's theme, and again when the theme changes.
(() => {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const hasWebgl = (() => {
    try {
      return Boolean(document.createElement("canvas").getContext("webgl"));
    } catch {
      return false;
    }
  })();

  function themed(text) {
    const ink = variable("--ink");
    const muted = variable("--muted");
    const grid = variable("--grid");
    const surface = variable("--surface");
    const spec = JSON.parse(
      text.replaceAll("$ink", ink).replaceAll("$muted", muted).replaceAll("$surface", surface)
    );
    const axis = { gridcolor: grid, zerolinecolor: grid, linecolor: grid, color: muted };
    const themeAxes = (holder) => {
      for (const key of Object.keys(holder)) {
        if (!/^[xyz]axis/.test(key)) continue;
        holder[key] = { ...axis, ...holder[key] };
        holder[key].title.font = { size: 12.5, color: muted };
      }
    };
    const layout = spec.layout;
    themeAxes(layout);
    if (layout.scene) {
      themeAxes(layout.scene);
      for (const key of ["xaxis", "yaxis", "zaxis"]) layout.scene[key].showbackground = false;
    }
    spec.layout = {
      margin: { l: 56, r: 16, t: 12, b: 48 },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, font: { color: ink } },
      hoverlabel: { bgcolor: surface, bordercolor: grid, font: { color: ink } },
      ...layout,
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: variable("--font"), size: 12.5, color: ink },
    };
    return spec;
  }

  const config = {
    responsive: true,
    displayModeBar: false,
    scrollZoom: false, // the wheel belongs to the page
  };

  const charts = [...document.querySelectorAll(".chart")].map((box) => {
    const text = box.querySelector("script").textContent;
    const plot = document.createElement("div");
    plot.className = "plot";
    box.append(plot);
    return { plot, text };
  });

  // a narrow box cuts the sides of the scene off
  function stepBack(eye) {
    for (const axis of ["x", "y", "z"]) eye[axis] *= 1.3;
  }

  function draw() {
    for (const { plot, text } of charts) {
      const spec = themed(text);
      if (spec.layout.scene && !hasWebgl) {
        plot.className = "no-webgl";
        plot.textContent = "This browser has no WebGL, which the 3-D map needs; the top view shows the same.";
        continue;
      }
      if (spec.layout.scene && plot.clientWidth < 480) stepBack(spec.layout.scene.camera.eye);
      Plotly.react(plot, spec.data, spec.layout, config);
    }
    document.documentElement.dataset.charts = "drawn";
  }

  draw();
  dark.addEventListener("change", draw);
})();
