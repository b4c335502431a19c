// How long until a success is held, over two settings: as a heat map, and as lines.

const UNSET = "–";

/** What became of a group: quartiles of when its runs first held the level, and of how many. */
function arrival(group) {
  const column = choices.x;
  const runs = runsOf(group);
  const times = runs.map((run) => {
    const i = firstToHold(run.columns.success_rate, choices.level / 100);
    return i < 0 ? Infinity : run.columns[column][i] ?? Infinity;
  });
  const [low, middle, high] = quartiles(times);
  const last = Math.max(...runs.map((run) => run.columns[column].at(-1) ?? 0));
  return { group, times, low, middle, high, last, reached: times.filter(Number.isFinite).length, runs: runs.length };
}

const arrivalText = (found) => `${found.reached} of ${found.runs}`;

/** Settings of the two axes; the rest make one view each. */
function levelAxes(groups) {
  const names = differingIn(groups, report.settings.map((setting) => setting.name));
  const telling = names.filter((name) => tellingSettings().includes(name));
  const across = names.includes(choices.across) ? choices.across
    : ["c_g", "kappa"].find((name) => names.includes(name)) ?? telling.at(-1) ?? null;
  const rest = telling.filter((name) => name !== across);
  let down = names.includes(choices.down) && choices.down !== across ? choices.down : null;
  if (choices.down !== "none") down ??= rest.includes("kappa") ? "kappa" : rest.find((name) => name !== "env" && name !== "curriculum") ?? rest[0] ?? null;
  return { names, across, down };
}

function drawLevels() {
  const groups = shownGroups();
  const { names, across, down } = levelAxes(groups);
  drawLevelControls(names, across, down);
  const found = inOrder(groups).map(arrival);
  const unit = X_AXES[choices.x].title;
  at("levels-caption").textContent =
    `${capital(unit)} until ${choices.level}\u00a0% success is held: the mean of ${report.holding} ` +
    "evaluations in a row. Medians over seeds; where half of the runs or more never get there, the median is “not reached”." +
    (choices.x === "wall_s" ? " Seconds are those of the program that trained a run, with all runs beside it." : "") +
    leftBefore(groups.flatMap(runsOf));
  const host = at("levels-views");
  stopObserving(host);
  host.replaceChildren();
  if (across) {
    const parted = differingIn(groups, tellingSettings()).filter((name) => name !== across && name !== down
      && !(name === "curriculum" && lacksAxis(groups, across)));
    const panels = panelsBy(groups, parted);
    const [maps, others] = [true, false].map((has) => panels.filter((panel) => hasMap(panel, across, down) === has));
    for (const panel of maps) drawLevelPair(host, panel, across, down);
    const lone = others.flatMap((panel) => panel.groups);
    if (lone.length) host.append(element("p", { class: "quiet" }, "Not on these axes: ", arrivalsText(lone.map(arrival)), "."));
  }
  fillLevelTable(found);
}

/** Whether a panel has more than one value across, and a group at most in a cell. */
function hasMap(panel, across, down) {
  const having = panel.groups.filter((group) => isKnown(valueIndex(group, across)));
  const columns = new Set(having.map((group) => valueIndex(group, across)));
  const cells = new Set(having.map((group) => `${valueIndex(group, across)} ${down && valueIndex(group, down)}`));
  return columns.size > 1 && cells.size === having.length;
}

const arrivalsText = (found) => found.map((one) =>
  `${fullLabel(one.group)} ${formatAmount(choices.x, one.middle)} (${arrivalText(one)})`).join("; ");

const leftEarly = (run) => isKnown(run.leave_at) && run.columns.epoch.at(-1) < run.epochs;

/** Of runs that ended on holding less than the level, that nobody knows when they would have. */
function leftBefore(runs) {
  const left = runs.filter((run) => leftEarly(run) && run.leave_at < choices.level / 100);
  return left.length ? ` ${countRuns(left.length)} could leave training on holding less than this, and did or were stopped.` : "";
}

/** Whether curricula are told by having the axis' setting or not. */
function lacksAxis(groups, across) {
  const having = groups.filter((group) => isKnown(valueIndex(group, across)));
  return having.length < groups.length &&
    new Set(having.map((group) => valueIndex(group, "curriculum"))).size <= 1;
}

function drawLevelControls(names, across, down) {
  const options = names.map((name) => [name, settingNamed(name).title]);
  fill(at("levels-controls"), ...(names.length < 2 ? [] : [
    selection("across", "across", options, across, (value) => choose({ across: value })),
    selection("down, and lines", "down", [["none", "–"], ...options.filter(([name]) => name !== across)],
      down ?? "none", (value) => choose({ down: value })),
  ]));
}

function drawLevelPair(host, panel, across, down) {
  const found = panel.groups.map(arrival);
  const having = found.filter((one) => isKnown(valueIndex(one.group, across)));
  const without = found.filter((one) => !having.includes(one));
  const unit = axisOf(choices.x, Math.max(...found.map((one) => one.last))).title;
  const heat = element("div"), lines = element("div");
  const title = panel.title ? element("h3", {}, panel.title) : null;
  const left = element("figure", { class: "panel" },
    element("p", { class: "quiet" }, `Median ${unit}: the darker the sooner (the lighter, on a dark page); below it how many runs reached ${choices.level}\u00a0%`),
    heat, withoutList(without, across));
  const right = element("figure", { class: "panel" },
    element("p", { class: "quiet" }, `${capital(unit)}: medians with quartiles, and every run` +
      (found.some((one) => one.reached < one.runs) ? "; open, where training ended, if success was not reached until then; the dotted line is where the longest ended" : "")),
    lines);
  host.append(element("div", {}, title ?? "", element("div", { class: "views" }, left, right)));
  const name = `${capital(unit)} until ${choices.level} % is held${panel.title ? `, ${panel.title}` : ""}`;
  fitted(heat, name, (width) => heatMap(having, across, down, width));
  fitted(lines, `${name}, as lines`, (width) => levelLines(found, across, down, width));
}

/** What became of runs that do not have the setting of the axis. */
function withoutList(without, across) {
  if (!without.length) return null;
  return element("p", { class: "quiet" }, `Without ${settingNamed(across).title}: ${arrivalsText(without)}.`);
}

function fillLevelTable(found) {
  const name = choices.x;
  const show = (value) => formatAmount(name, value);
  at("levels-table").replaceChildren(table(
    [{ title: "Setting" }, { title: "Reached", number: true }, { title: "Lower quartile", number: true },
     { title: `Median, ${X_AXES[name].short}`, number: true }, { title: "Upper quartile", number: true },
     { title: "Trained for", number: true }],
    found.map((one) => [fullLabel(one.group), arrivalText(one), show(one.low), show(one.middle), show(one.high), show(one.last)])));
}
