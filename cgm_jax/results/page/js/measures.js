// Everything else in metrics.jsonl: numbers as curves, arrays as heat maps over training.

const shownElsewhere = (measure) => measure.name === "success_rate" || measure.name.startsWith("mask_");
const columnsOf = (run, { name, array }) => (array ? run.arrays[name]?.values.flat() : run.columns[name]) ?? [];

/** Measures of the runs shown: those that have a value, and those that are never another than 0. */
function otherMeasures() {
  const runs = shownGroups().flatMap(runsOf);
  const values = (measure) => runs.flatMap((run) => columnsOf(run, measure)).filter(isKnown);
  const found = report.measures.filter((measure) => !shownElsewhere(measure) && values(measure).length);
  return d3.group(found, (measure) => (values(measure).some((value) => value !== 0) ? "told" : "zero"));
}

function drawMeasures() {
  const found = otherMeasures(), measures = found.get("told") ?? [];
  const zero = found.has("zero") ? ` Zero in all epochs: ${found.get("zero").map(({ title }) => title).join(", ")}.` : "";
  at("measures").hidden = !measures.length;
  if (!measures.length) return;
  const measure = measures.find(({ name }) => name === choices.measure)
    ?? measures.find(({ name }) => name === "subgoal_success") ?? measures[0];
  const groups = shownGroups().filter((group) => runsOf(group).some((run) => run.arrays[measure.name]));
  const group = measure.array ? groupOf(groups) : null;
  fill(at("measures-controls"),
    selection("measure", "measure", measures.map(({ name, title }) => [name, title]), measure.name, (value) => choose({ measure: value })),
    group && groups.length > 1 ? groupSelection(groups, group) : "");
  at("measures-caption").textContent = measure.array
    ? `${capital(measure.title)} over ${X_AXES[choices.x].title}: ${fullLabel(group)}${group.runs.length > 1 ? `, median of ${group.runs.length} seeds` : ""}.${zero}`
    : `${capital(measure.title)} over ${X_AXES[choices.x].title}, as metrics.jsonl has it.${zero}`;
  const host = at("measures-panels");
  if (measure.array) {
    host.previousElementSibling?.matches(".key") && host.previousElementSibling.remove();
    const array = runsOf(group).find((run) => run.arrays[measure.name]).arrays[measure.name];
    const some = array.labels.length < array.total ? `${array.labels.length} of ${array.total} values` : "";
    multiples(host, [{ title: some }], (panel, width) => arrayChart(group, measure, array, width));
  } else {
    drawCurves(host, measure.name, measure.title, false);
  }
}

/** An array over training, a row per value; an epoch reaches back to the one before. */
function arrayChart(group, measure, array, width) {
  const cells = array.labels.flatMap((label, row) => {
    let before = 0;
    return rowCurve(group, measure.name, row).map((point) => {
      const cell = { label, from: before, to: point.x, value: point.y, epoch: point.epoch };
      before = point.x;
      return cell;
    });
  });
  const known = cells.filter((cell) => isKnown(cell.value));
  const axis = axisOf(choices.x, d3.max(cells, (cell) => cell.to) ?? 1);
  const low = Math.min(0, d3.min(known, (cell) => cell.value)), high = d3.max(known, (cell) => cell.value);
  const shade = (value) => `var(--heat-${heatStep(high > low ? (value - low) / (high - low) : 0.5)})`;
  const labels = array.labels, rowHeight = Math.max(13, Math.min(30, 360 / labels.length));
  return Plot.plot({
    width, height: labels.length * rowHeight + 70, marginLeft: Math.max(...labels.map(textWidth)) + 20, marginTop: 30, marginBottom: 36, style: STYLE,
    x: { label: axis.title, tickFormat: axis.format, domain: [0, (d3.max(cells, (cell) => cell.to) ?? 1) * axis.scale], ticks: Math.round(width / 100) },
    y: { type: "band", domain: labels, padding: 0.08, label: null, tickSize: 0 },
    marks: [
      Plot.barX(cells, { x1: (cell) => cell.from * axis.scale, x2: (cell) => cell.to * axis.scale, y: "label",
                         fill: (cell) => (isKnown(cell.value) ? shade(cell.value) : "var(--none)") }),
      Plot.text([`from faint, ${formatNumber(low)}, to strong, ${formatNumber(high)}; grey: no value`],
        { frameAnchor: "top-left", dy: -20, textAnchor: "start", fill: "var(--soft)" }),
      Plot.tip(known, Plot.pointer({ x: (cell) => (cell.from + cell.to) / 2 * axis.scale, y: "label", fill: "var(--paper)", stroke: "var(--rule)",
        title: (cell) => `${cell.label}, epoch ${cell.epoch}: ${d3.format(".4~g")(cell.value)}` })),
    ],
  });
}
