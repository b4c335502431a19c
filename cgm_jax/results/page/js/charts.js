// What charts have in common: axes, panels that fit their width, labels beside lines.

const X_AXES = {
  env_steps: { title: "environment steps", short: "steps", column: "env_steps" },
  wall_s: { title: "seconds of training", short: "seconds", column: "wall_s" },
  epoch: { title: "epochs", short: "epochs", column: "epoch" },
};

/** How numbers up to `most` on an axis are told: { title, scale, format }. */
function axisOf(name, most) {
  if (name === "wall_s") {
    if (most > 3 * 3600) return { title: "hours of training", scale: 1 / 3600, format: d3.format("~f") };
    if (most > 600) return { title: "minutes of training", scale: 1 / 60, format: d3.format("~f") };
  }
  const format = name === "env_steps" ? formatSteps : d3.format(",~f");
  return { title: X_AXES[name].title, scale: 1, format };
}

const formatSteps = (steps) => (steps === 0 ? "0" : d3.format(Math.abs(steps) < 1000 ? "~f" : "~s")(steps));

/** A number of the chosen axis as text, in a table or a cell. */
function formatAmount(name, value) {
  if (!isKnown(value)) return "–";
  if (value === Infinity) return "not reached";
  if (name === "env_steps") return d3.format(value < 1e6 ? ",.0f" : ".3~s")(value);
  return d3.format(value < 100 ? ",.1~f" : ",.0f")(value);
}

const formatNumber = (value) =>
  (value === 0 ? "0" : d3.format(Math.abs(value) >= 1e4 ? ".3~s" : Math.abs(value) < 1e-3 ? ".2~e" : ".4~r")(value));

const percent = (share) => `${d3.format(".3~r")(100 * share)}\u00a0%`;
const formatPercent = (share) => d3.format("~f")(100 * share);

const observers = new Map();

/** Draw for the width of a sheet, or for the window again: a browser does not wait for observers. */
function fitToPaper(printing) {
  document.body.classList.toggle("printing", printing);
  for (const { redraw } of observers.values()) redraw();
}

/** Draw into an element what is called so, again whenever its width changes. */
function fitted(container, name, draw) {
  let width = 0;
  const redraw = () => {
    const now = Math.floor(container.clientWidth);
    if (now === width || now === 0) return;
    width = now;
    const chart = draw(width);
    if (chart instanceof SVGElement) {
      chart.setAttribute("role", "img");
      chart.setAttribute("aria-label", name);
    }
    container.replaceChildren(chart);
  };
  const observer = new ResizeObserver(redraw);
  observer.observe(container);
  observers.set(container, { observer, redraw });
  redraw();
}

/** Panels with a title each; draw(panel, width) makes a chart. */
function multiples(container, panels, draw) {
  stopObserving(container);
  container.classList.toggle("one", panels.length === 1);
  const figures = panels.map((panel) => {
    const body = element("div");
    return [element("figure", { class: "panel" },
      panel.title ? element("h3", {}, panel.title) : null, panel.key ?? null, body), body, panel];
  });
  container.replaceChildren(...figures.map(([figure]) => figure));
  const heading = container.closest("section").querySelector("h2").textContent;
  for (const [, body, panel] of figures) {
    fitted(body, panel.title ? `${heading}: ${panel.title}` : heading, (width) => draw(panel, width));
  }
}

function stopObserving(container) {
  for (const [element, watched] of observers) {
    if (!element.isConnected || container.contains(element)) {
      watched.observer.disconnect();
      observers.delete(element);
    }
  }
}

/** Heights of labels beside the ends of lines, moved apart so that none hides another. */
function spreadApart(ends, least, low, high) {
  const sorted = [...ends].sort((a, b) => a.y - b.y);
  let floor = low;
  for (const end of sorted) {
    end.place = Math.max(end.y, floor);
    floor = end.place + least;
  }
  let ceiling = high;
  for (const end of sorted.reverse()) {
    end.place = Math.min(end.place, ceiling);
    ceiling = end.place - least;
  }
  return ends;
}

const textWidth = (() => {
  const context = document.createElement("canvas").getContext("2d");
  return (text) => {
    context.font = "11px system-ui, sans-serif";
    return context.measureText(text).width;
  };
})();

const STYLE = { background: "none", overflow: "visible" };
