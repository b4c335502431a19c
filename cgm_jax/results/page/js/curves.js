// Learning curves: a line per group, the median over its seeds; a panel per value of a setting.

/** Whether labels beside lines tell in all panels which line is which. */
function labelsServe(panels, measure, rate) {
  return panels.every((panel) => {
    if (panel.lines.length < 2) return true;
    if (panel.lines.length > MOST_LABELS || Math.max(...panel.lines.map((line) => textWidth(line.label))) > 130) return false;
    const curves = panel.lines.map((line) => ({ ...line, ...curveOf(line.group, measure, choices.x) }));
    const domain = rate ? [0, 1] : extentOf(curves.flatMap((curve) => curve.seeds.flat()));
    const near = 2 * 13 * (domain[1] - domain[0]) / 180;
    return endsOf(curves, domain, 180).every((end) => Math.abs(end.place - end.y) <= near);
  });
}

/** Panels of a measure over the chosen axis, with a key above them where labels do not serve. */
function drawCurves(container, measure, yTitle, rate) {
  const panels = curvePanels(measure, yTitle, rate);
  const keys = new Set(panels.map((panel) => JSON.stringify(panel.entries)));
  const narrow = container.clientWidth < 480;
  for (const panel of panels) panel.direct &&= !narrow || Math.max(...panel.lines.map((line) => textWidth(line.label))) < 90;
  const needed = panels.some((panel) => panel.lines.length > 1 && !panel.direct);
  if (needed && keys.size > 1) for (const panel of panels) panel.key = panel.lines.length > 1 ? key(panel.entries) : null;
  container.previousElementSibling?.matches(".key") && container.previousElementSibling.remove();
  if (needed && keys.size === 1) container.before(key(panels[0].entries));
  multiples(container, panels, (panel, width) => curveChart(panel, width, measure, rate));
}

function curvePanels(measure, yTitle, rate) {
  const groups = shownGroups().filter((group) => runsOf(group).some((run) => run.columns[measure]));
  const names = panelSettings(groups);
  const panels = panelsBy(groups, names);
  const most = Math.max(0, ...groups.flatMap((group) => runsOf(group).map((run) => d3.max(run.columns[choices.x]) ?? 0)));
  const shared = sharedLabel(groups, names);
  for (const panel of panels) {
    panel.lines = linesOf(panel.groups);
    panel.yTitle = yTitle;
    panel.most = most || 1;
    panel.title = [panel.title, ...(panels.length === 1 ? [shared] : [])].filter(Boolean).join(", ");
    panel.entries = keyEntries(panel.lines);
  }
  const direct = labelsServe(panels, measure, rate);
  for (const panel of panels) panel.direct = direct;
  return panels;
}

/** What all of these groups have in common of the settings that tell groups apart. */
function sharedLabel(groups, names) {
  if (!groups.length) return "";
  const differ = new Set([...differingIn(groups, tellingSettings()), ...names]);
  return labelOf(groups[0], tellingSettings().filter((name) => !differ.has(name)));
}

/** Settings whose values make panels: the chosen one, or all but the colour. */
function panelSettings(groups) {
  if (choices.panel === "none") return [];
  if (choices.panel !== "others") return [choices.panel];
  return otherSettings(groups);
}

function otherSettings(groups) {
  return differingIn(groups, tellingSettings()).filter((name) => name !== choices.colour &&
    !(name === "curriculum" && settingNamed(choices.colour) && onlyLacking(groups)));
}

/** Whether curricula are told by having the colour's setting or not. */
function onlyLacking(groups) {
  const having = groups.filter((group) => isKnown(valueIndex(group, choices.colour)));
  return having.length < groups.length &&
    new Set(having.map((group) => valueIndex(group, "curriculum"))).size <= 1;
}

const MOST_ENTRIES = 40;

function keyEntries(lines) {
  const shown = lines.slice(0, MOST_ENTRIES).map(({ colour, dash, label }) => ({ colour, dash, label }));
  const left = lines.length - shown.length;
  return left ? [...shown, { colour: "none", label: `and ${left} more` }] : shown;
}

function drawLearning() {
  drawCurves(at("learning-panels"), "success_rate", "success rate, full goal", true);
  const several = shownGroups().some((group) => group.runs.length > 1);
  at("learning-caption").textContent =
    `Success of the full goal in noise-free evaluation, over ${X_AXES[choices.x].title}. ` +
    (several ? "Lines are medians over seeds" + (choices.spread === "seeds" ? ", with every run as a thin line" : ", with quartiles as a band")
      + "; where some seeds ended before others, the rest continue as thin lines. " : "") +
    (report.runs.some((run) => run.failed) ? "A cross marks where a run diverged; from there on it is its last finite policy. " : "") +
    (choices.x === "wall_s" ? "Seconds are those of the program that trained a run, with all runs beside it. " : "") +
    `Dotted: ${choices.level}\u00a0%.`;
}
