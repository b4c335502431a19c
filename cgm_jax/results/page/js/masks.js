// Masks of one group over training: how often they are drawn, and how often they succeed.

const MASK_LINES = [
  { name: "mask_rate_estimated", label: "estimated success", colour: "var(--series-0)" },
  { name: "mask_rate_training", label: "success in training", colour: "var(--series-1)" },
];
const DRAWN = [
  { name: "mask_probability", label: "chance of being drawn" },
  { name: "mask_share", label: "share of episodes" },
];

const hasMasks = (group) => runsOf(group).some((run) =>
  MASK_LINES.some(({ name }) => run.arrays[name]?.values.slice(0, -1).some((row) => row.some(isKnown))));

/** The group that a section shows: the chosen one, or the one with most success of all. */
function groupOf(groups) {
  const chosen = groups.find((group) => fullLabel(group) === choices.group);
  if (chosen) return chosen;
  const horizon = Math.max(...groups.flatMap(runsOf).map((run) => run.columns.env_steps.at(-1)));
  const success = (group) => mean(runsOf(group).map((run) => successOver(run, horizon)));
  return d3.greatest(groups, (a, b) => success(a) - success(b));
}

/** Sum of a run's success over so many environment steps; one that ended before counts on with its last. */
function successOver({ columns }, horizon) {
  const rates = columns.success_rate.map((rate) => rate ?? 0);
  const during = d3.sum(rates, (rate, i) => rate * (columns.env_steps[i] - (columns.env_steps[i - 1] ?? 0)));
  return during + rates.at(-1) * (horizon - columns.env_steps.at(-1));
}

function groupSelection(groups, chosen) {
  const options = inOrder(groups).map(fullLabel).map((label) => [label, label]);
  return selection("setting", "group", options, fullLabel(chosen), (group) => choose({ group }));
}

/** Medians over a group's seeds of one row of an array, up to where its first run ends. */
function rowCurve(group, name, row) {
  const runs = runsOf(group).filter((run) => run.arrays[name]);
  if (!runs.length) return [];
  const common = Math.min(...runs.map((run) => run.columns.epoch.at(-1)));
  const byEpoch = d3.groups(runs.flatMap((run) => run.columns.epoch.map((epoch, i) =>
    ({ epoch, x: run.columns[choices.x][i], y: run.arrays[name].values[row]?.[i] ?? null }))), (d) => d.epoch);
  const points = byEpoch.filter(([epoch]) => epoch <= common).map(([epoch, there]) => {
    const known = there.map((d) => d.y).filter(isKnown), places = there.map((d) => d.x).filter(isKnown);
    return { epoch, x: places.length ? quartiles(places)[1] : NaN, y: known.length ? quartiles(known)[1] : null };
  }).sort((a, b) => a.epoch - b.epoch);
  markLonely(points);
  return points;
}

function drawMasks() {
  const groups = shownGroups().filter(hasMasks);
  at("masks").hidden = !groups.length;
  if (!groups.length) return;
  const group = groupOf(groups);
  fill(at("masks-controls"), groups.length > 1 ? groupSelection(groups, group) : "");
  const arrays = Object.assign({}, ...runsOf(group).map((run) => run.arrays));
  const drawn = DRAWN.find(({ name }) => arrays[name]);
  const shape = arrays.mask_rate_estimated ?? arrays.mask_rate_training;
  const some = shape.labels.length < shape.total ? ` Of ${shape.total.toLocaleString("en")} masks, those of one dimension and the full goal.` : "";
  at("masks-caption").replaceChildren(
    element("span", {}, `A panel per mask, named by the dimensions that it keeps; the rest count as achieved. ` +
      `${group.runs.length > 1 ? `Medians over ${group.runs.length} seeds. ` : ""}${fullLabel(group)}.${some}`));
  const target = valueOf(group, "c_g")?.number;
  const entries = [...MASK_LINES.filter(({ name }) => arrays[name]),
    ...(drawn ? [{ label: drawn.label, colour: "var(--faint)", width: 8 }] : []),
    ...(isKnown(target) ? [{ label: "c_g", colour: "var(--faint)", dash: "2 3", width: 1.5 }] : [])];
  at("masks-caption").append(key(entries));
  const most = Math.max(...runsOf(group).map((run) => d3.max(run.columns[choices.x]) ?? 0)) || 1;
  const panels = shape.labels.map((label, row) => ({ title: label === "none" ? "nothing kept" : label, row }));
  multiples(at("masks-panels"), panels, (panel, width) => maskChart(group, panel.row, drawn, target, most, width));
}

function maskChart(group, row, drawn, target, most, width) {
  const axis = axisOf(choices.x, most);
  const x = (point) => (isKnown(point.x) ? point.x * axis.scale : NaN), y = (point) => point.y ?? NaN;
  const marks = MASK_LINES.flatMap(({ name, colour }) => {
    const points = rowCurve(group, name, row);
    return [Plot.line(points, { x, y, stroke: colour, strokeWidth: 1.8 }),
            Plot.dot(points.filter((point) => point.lonely), { x, y, fill: colour, r: 2.5 })];
  });
  return Plot.plot({
    width, height: 150, marginLeft: 40, marginRight: 8, marginTop: 8, marginBottom: 32, style: STYLE,
    x: { domain: [0, most * axis.scale], label: width > 200 ? axis.title : X_AXES[choices.x].short, tickFormat: axis.format, ticks: width > 200 ? 4 : 2 },
    y: { domain: [0, 1], ticks: 3, tickFormat: (share) => (share === 1 ? "100 %" : formatPercent(share)), label: null },
    marks: [
      Plot.gridY({ stroke: "var(--rule)", strokeOpacity: 1, ticks: 3 }),
      drawn ? Plot.areaY(rowCurve(group, drawn.name, row), { x, y, fill: "var(--faint)", fillOpacity: 0.28, curve: "step" }) : null,
      Plot.ruleY([0], { stroke: "var(--faint)" }),
      isKnown(target) ? Plot.ruleY([target / 100], { stroke: "var(--faint)", strokeDasharray: "2 3" }) : null,
      ...marks,
    ],
  });
}
