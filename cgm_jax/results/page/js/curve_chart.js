// One panel of curves: medians over seeds with their spread, crosses, labels beside the lines.

/** A group's curve of a measure: points up to where its first run ends, what follows, crosses. */
function curveOf(group, measure, x) {
  const runs = runsOf(group).filter((run) => run.columns[measure]);
  if (!runs.length) return { points: [], rest: [], seeds: [], crosses: [] };
  const tables = runs.map((run) => new Map(run.columns.epoch.map((epoch, i) =>
    [epoch, { x: run.columns[x][i], y: run.columns[measure][i] }])));
  const ends = runs.map((run) => run.columns.epoch.at(-1));
  const common = Math.min(...ends);
  const epochs = [...new Set(runs.flatMap((run) => run.columns.epoch))].sort((a, b) => a - b);
  const points = [];
  for (const epoch of epochs.filter((epoch) => epoch <= common)) {
    const there = tables.map((table) => table.get(epoch)).filter((point) => point && isKnown(point.x));
    if (!there.length) continue;
    const known = there.map((point) => point.y).filter(isKnown);
    const [low, middle, high] = known.length ? quartiles(known) : [null, null, null];
    points.push({ epoch, x: quartiles(there.map((point) => point.x))[1],
                  low, y: middle, high, known: known.length });
  }
  markLonely(points);
  const seeds = runs.map((run) => run.columns.epoch.map((epoch, i) =>
    ({ epoch, x: run.columns[x][i], y: run.columns[measure][i], run })));
  const rest = seeds.map((seed) => seed.filter((point) => point.epoch >= common)).filter((seed) => seed.length > 1);
  const crosses = runs.filter((run) => run.failed).map((run) => {
    const i = run.columns.epoch.indexOf(run.failed.epoch);
    const known = run.columns[measure].slice(0, i + 1).filter(isKnown);
    const none = measure === "success_rate" ? 0 : known.at(-1) ?? null;  // success that was not is none
    return { x: run.columns[x][i], y: run.columns[measure][i] ?? none, run };
  });
  return { points, rest, seeds, crosses, runs: runs.length };
}

/** Points without a neighbour, which no line would show. */
function markLonely(points) {
  points.forEach((point, i) => {
    point.lonely = isKnown(point.y) && !isKnown(points[i - 1]?.y) && !isKnown(points[i + 1]?.y);
  });
}

/** Lines of one panel as a chart; `rate` if the measure is a share. */
function curveChart(panel, width, measure, rate) {
  const curves = panel.lines.map((line) => ({ ...line, ...curveOf(line.group, measure, choices.x) }));
  const every = curves.flatMap((curve) => curve.seeds.flat());
  if (!every.some((point) => isKnown(point.y) && isKnown(point.x))) {
    return element("p", { class: "quiet" }, "No value in any epoch.");
  }
  const axis = axisOf(choices.x, panel.most);
  const scaled = (point) => (isKnown(point.x) ? point.x * axis.scale : NaN);
  const height = Math.round(Math.max(190, Math.min(340, width * 0.62)));
  const beside = panel.direct ? labelsBeside(curves, width) : 0;
  const margins = { marginTop: 26, marginBottom: 34, marginLeft: 40, marginRight: beside ? beside + 12 : 12 };
  const marks = curves.flatMap((curve) => curveMarks(curve, scaled, curves.length));
  const y = rate
    ? { domain: [0, 1], ticks: 5, tickFormat: formatPercent, label: `${panel.yTitle} (%)` }
    : { domain: extentOf(every), nice: true, ticks: 5, tickFormat: formatNumber, label: panel.yTitle };
  if (beside) marks.push(endLabels(curves, y.domain, height - 60));
  return Plot.plot({
    width, height, ...margins, style: STYLE,
    x: { domain: [0, panel.most * axis.scale], label: axis.title, tickFormat: axis.format,
         ticks: Math.max(3, Math.round(width / 90)) },
    y: { ...y, labelAnchor: "top" },
    marks: [
      Plot.gridY({ stroke: "var(--rule)", strokeOpacity: 1, ticks: 5 }),
      Plot.ruleY([0], { stroke: "var(--faint)" }),
      rate ? Plot.ruleY([choices.level / 100], { stroke: "var(--faint)", strokeDasharray: "1 3" }) : null,
      ...marks, curveTip(curves, scaled, axis, rate),
    ],
  });
}

function curveMarks(curve, scaled, count) {
  const { colour, dash, points } = curve;
  const known = (point) => isKnown(point.y);
  const marks = [];
  if (choices.spread === "seeds" && curve.runs > 1) {
    marks.push(...curve.seeds.map((seed) => Plot.line(seed, {
      x: scaled, y: (d) => d.y ?? NaN, stroke: colour, strokeWidth: 0.8, strokeOpacity: 0.45 })));
  } else if (curve.runs > 1) {
    const opacity = count > 8 ? 0.07 : 0.15;
    marks.push(Plot.areaY(points, { x: scaled, y1: (d) => d.low ?? NaN, y2: (d) => d.high ?? NaN,
                                    fill: colour, fillOpacity: opacity }));
    marks.push(Plot.ruleX(points.filter((d) => d.lonely), {
      x: scaled, y1: "low", y2: "high", stroke: colour, strokeOpacity: 0.4, strokeWidth: 3 }));
  }
  if (curve.runs > 1) {
    marks.push(...curve.rest.map((seed) => Plot.line(seed, {
      x: scaled, y: (d) => d.y ?? NaN, stroke: colour, strokeWidth: 0.8, strokeOpacity: 0.6 })));
  }
  marks.push(Plot.line(points, { x: scaled, y: (d) => d.y ?? NaN, stroke: colour, strokeWidth: 1.9,
                                 strokeDasharray: dash, strokeLinejoin: "round" }));
  marks.push(Plot.dot(points.filter((d) => d.lonely), { x: scaled, y: "y", fill: colour, r: 3 }));
  marks.push(Plot.dot(curve.crosses, { x: scaled, y: "y", symbol: "times", stroke: colour, r: 5,
                                       strokeWidth: 1.8 }));
  return marks;
}

/** From zero, or from below it, to the largest value; never an empty range. */
function extentOf(points) {
  const values = points.map((point) => point.y).filter(isKnown);
  const [low, high] = d3.extent([0, ...values]);  // of more than a function takes arguments
  return low === high ? [0, 1] : [low, high];
}

const MOST_LABELS = 8;

/** Room for labels beside the lines; 0 if they are too many or too long. */
function labelsBeside(curves, width) {
  if (curves.length < 2 || curves.length > MOST_LABELS) return 0;
  const widest = Math.max(...curves.map((curve) => textWidth(curve.label)));
  return widest < width * 0.28 ? Math.ceil(widest) : 0;
}

/** Where labels stand beside the ends of lines; far from them if many lines end close together. */
function endsOf(curves, [low, high], height) {
  const ends = curves.flatMap((curve) => {
    const last = curve.points.filter((point) => isKnown(point.y)).at(-1);
    return last ? [{ y: last.y, label: curve.label, colour: curve.colour }] : [];
  });
  return spreadApart(ends, 13 * (high - low) / height, low, high);
}

function endLabels(curves, domain, height) {
  return Plot.text(endsOf(curves, domain, height), { frameAnchor: "right", y: "place", text: "label", fill: "colour",
                           textAnchor: "start", dx: 8, fontWeight: 500 });
}

function curveTip(curves, scaled, axis, rate) {
  const points = curves.flatMap((curve) => curve.points.filter((d) => isKnown(d.y)).map((d) => ({ ...d, curve })));
  const show = (value) => (rate ? percent(value) : d3.format(".4~g")(value));
  return Plot.tip(points, Plot.pointer({
    x: scaled, y: "y", fill: "var(--paper)", stroke: "var(--rule)", lineWidth: 22,
    title: (d) => [
      fullLabel(d.curve.group),
      `${axis.format(scaled(d) >= 100 ? Math.round(scaled(d)) : d3.format(".4~r")(scaled(d)))} ${axis.title}, epoch ${d.epoch}`,
      d.known > 1 ? `median ${show(d.y)}  (${show(d.low)} to ${show(d.high)}, ${d.known} runs)` : show(d.y),
    ].join("\n"),
  }));
}
