// Puts the page together once its data are unpacked.

let report;

async function unpack() {
  const bytes = Uint8Array.from(atob(at("data").textContent), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).json();
}

/** The setting that colours tell unless another is chosen: c_g, or the one with most values. */
function usualColour() {
  const names = differingIn(report.groups, tellingSettings()).filter((name) => name !== "env");
  return names.includes("c_g") ? "c_g" : d3.greatest(names, (a, b) => settingNamed(a).values.length - settingNamed(b).values.length) ?? "none";
}

const MOST_PANELS = 12;

function usualPanels() {
  const others = otherSettings(report.groups);
  if (!others.length) return "none";
  return panelsBy(report.groups, others).length <= MOST_PANELS ? "others" : others[0];
}

function checkChoices() {
  const names = ["none", ...report.settings.map((setting) => setting.name)];
  if (!names.includes(choices.colour)) choices.colour = usualColour();
  if (!["others", ...names].includes(choices.panel)) choices.panel = usualPanels();
}

function drawControls() {
  const settings = report.settings.map((setting) => [setting.name, setting.title]);
  const level = element("input", { type: "range", name: "level", min: 5, max: 100, step: 5, value: choices.level,
    oninput: () => { said.textContent = `level: ${level.value} %`; }, onchange: () => choose({ level: Number(level.value) }) });
  const said = element("span", {}, `level: ${choices.level} %`);
  const several = report.groups.some((group) => group.runs.length > 1);
  fill(at("controls"),
    segments("over", Object.entries(X_AXES).map(([name, axis]) => [name, axis.short]), choices.x, (x) => choose({ x })),
    ...(settings.length ? [
      selection("colour", "colour", [["none", "–"], ...settings], choices.colour, (colour) => choose({ colour })),
      selection("panels", "panel", [["none", "one panel"], ["others", "all other settings"], ...settings], choices.panel, (panel) => choose({ panel })),
    ] : []),
    several ? segments("spread", [["quartiles", "quartiles"], ["seeds", "every run"]], choices.spread, (spread) => choose({ spread })) : "",
    element("label", { class: "control" }, said, level));
  drawFilters();
  at("choices-in-print").textContent = `Over ${X_AXES[choices.x].title}; colour: ${settingNamed(choices.colour)?.title ?? "none"}; level: ${choices.level} %.`;
}

/** A row of switches per setting; those of the colour's setting are the key to the colours. */
function drawFilters() {
  const groups = shownGroups();
  const crowded = panelsBy(groups, panelSettings(groups)).some((panel) => isCrowded(panel.groups));
  const named = report.settings.filter((setting) => !setting.between || setting.name === choices.colour);
  fill(at("filters"), ...named.map((setting) => element("div", { class: "filter", role: "group", "aria-label": setting.title },
    element("span", {}, setting.title),
    ...setting.values.map((value, index) => element("button", {
      type: "button", class: "chip", "data-setting": setting.name, "data-index": index,
      "aria-pressed": String(!choices.hidden[setting.name]?.has(index)), onclick: () => toggle(setting.name, index),
    }, setting.name === choices.colour && !crowded ? element("i", { class: "swatch", style: `border-color: ${valueColour(setting, index)}` }) : null, value.text)))));
  document.querySelector(".filters").hidden = !named.length;
}

function drawTheme() {
  const dark = choices.theme === "dark" || (choices.theme !== "light" && matchMedia("(prefers-color-scheme: dark)").matches);
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  fill(at("theme"), segments("theme", [["auto", "auto"], ["light", "light"], ["dark", "dark"]], choices.theme, (theme) => choose({ theme })));
}

function drawAll() {
  drawTheme();
  drawControls();
  for (const draw of [drawLearning, drawLevels, drawFinal, drawMasks, drawMeasures]) draw();
}

/** Look for a newer page now and then, unless somebody is using this one just now. */
function reloadSometimes() {
  let used = 0;
  for (const kind of ["pointerdown", "pointermove", "keydown", "wheel", "touchmove"]) {
    addEventListener(kind, () => { used = Date.now(); }, { passive: true });
  }
  setInterval(() => {
    if (Date.now() - used > 5000 && document.visibilityState === "visible") location.reload();
  }, 1000 * report.reload);
  say(`Training is being followed: this page looks for new epochs every ${report.reload} seconds, and keeps what you have chosen.`);
}

function say(text) {
  at("notice").textContent = text;
  at("notice").hidden = false;
}

async function start() {
  report = await unpack();
  readChoices();
  checkChoices();
  definePalette();
  drawHead();
  drawSweeps();
  if (matchMedia("(max-width: 44rem)").matches) document.querySelector(".filters").open = report.settings.length < 2;
  if (report.runs.length) drawAll();
  else {
    drawTheme();
    for (const part of document.querySelectorAll(".toolbar, main > section:not(#sweeps)")) part.hidden = true;
    say("No epoch is finished yet.");
  }
  addEventListener("beforeprint", () => fitToPaper(true));
  addEventListener("afterprint", () => fitToPaper(false));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawTheme);
  if (report.reload) reloadSometimes();
  document.body.dataset.ready = "true";
}

start().catch((error) => {
  say(typeof DecompressionStream === "undefined"
    ? "This page needs a browser of 2023 or later." : `This page cannot be drawn: ${error.message}`);
  throw error;
});
