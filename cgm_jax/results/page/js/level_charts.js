// Time to a level as a heat map over two settings, and as lines over one of them.

const textOn = (group, name) => (name ? valueOf(group, name)?.text ?? UNSET : "");

function domainOf(found, name) {
  if (!name) return [""];
  const there = new Set(found.map((one) => textOn(one.group, name)));
  return [...settingNamed(name).values.map((value) => value.text), UNSET].filter((text) => there.has(text));
}

function heatMap(found, across, down, width) {
  const cells = found.map((one) => ({ ...one, x: textOn(one.group, across), y: textOn(one.group, down) }));
  const columns = domainOf(found, across), rows = domainOf(found, down);
  const known = cells.map((cell) => cell.middle).filter(Number.isFinite);
  const low = d3.min(known) ?? 0, high = d3.max(known) ?? 1;
  const step = (cell) => heatStep(high > low ? 1 - (cell.middle - low) / (high - low) : 0.7);
  const shade = (cell) => (Number.isFinite(cell.middle) ? `var(--heat-${step(cell)})` : "var(--none)");
  const ink = (cell) => (Number.isFinite(cell.middle) ? `var(--heat-ink-${step(cell)})` : "var(--soft)");
  const longest = Math.max(...rows.map(textWidth));
  const cellWidth = (width - longest - 50) / columns.length;
  const axis = axisOf(choices.x, Math.max(...found.map((one) => one.last)));
  const turned = Math.max(...columns.map(textWidth)) > cellWidth - 6;
  const foot = turned ? 0.75 * Math.max(...columns.map(textWidth)) : 0;
  const roomy = cellWidth >= 40;  // else the table below has the numbers
  const shown = (cell) => Number.isFinite(cell.middle)
    ? d3.format(choices.x === "env_steps" ? ".3~s" : ".3~r")(cell.middle * axis.scale) : cellWidth > 62 ? "not reached" : "–";
  return Plot.plot({
    width, height: rows.length * 46 + 48 + foot, marginLeft: longest + 34, marginTop: 6, marginBottom: 42 + foot, marginRight: 4, style: STYLE,
    x: { type: "band", domain: columns, label: settingNamed(across).title, padding: 0.04, tickSize: 0, labelOffset: 36 + foot, tickRotate: turned ? -45 : 0 },
    y: { type: "band", domain: rows, label: rows.length > 1 ? settingNamed(down).title : null, padding: 0.06, tickSize: 0, labelOffset: longest + 28 },
    marks: [
      Plot.cell(cells, { x: "x", y: "y", rx: 3, inset: 0, fill: shade }),
      Plot.text(roomy ? cells : [], { x: "x", y: "y", text: shown, fill: ink, fontSize: 12.5, fontWeight: 600, dy: -6 }),
      Plot.text(roomy ? cells : [], { x: "x", y: "y", text: arrivalText, fill: ink, fontSize: 10, fillOpacity: 0.85, dy: 9 }),
      Plot.tip(cells, Plot.pointer({ x: "x", y: "y", fill: "var(--paper)", stroke: "var(--rule)", lineWidth: 22, title: arrivalTip })),
    ],
  });
}

function arrivalTip(found) {
  const times = found.times.map((time) => formatAmount(choices.x, time)).join(", ");
  return `${fullLabel(found.group)}\n${arrivalText(found)} runs reached ${choices.level} %\n${X_AXES[choices.x].short}: ${times}`;
}

function levelLines(found, across, down, width) {
  const setting = settingNamed(across);
  const having = found.filter((one) => isKnown(valueIndex(one.group, across)));
  const without = found.filter((one) => !isKnown(valueIndex(one.group, across)));
  const most = Math.max(...found.map((one) => one.last), 0);
  const axis = axisOf(choices.x, most);
  const place = placesOf(setting, having, width);
  const down_ = down && settingNamed(down);
  const colour = (one) => !down_ ? "var(--series-0)"
    : isKnown(valueIndex(one.group, down)) ? valueColour(down_, valueIndex(one.group, down)) : "var(--ink)";
  const at_ = (value, one) => (Number.isFinite(value) ? value : one.last) * axis.scale;  // where training ended
  const series = d3.groups(having, (one) => (down ? valueOf(one.group, down)?.label ?? `no ${down_.title}` : ""));
  const beside = Math.max(0, ...series.map(([text]) => textWidth(text)), ...without.map((one) => textWidth(withoutLabel(one, across))));
  const ends = [
    ...series.map(([text, own]) => ({ own: own.at(-1), text })),
    ...without.map((one) => ({ own: one, text: withoutLabel(one, across) })),
  ].filter((end) => end.text).map((end) => ({ y: at_(end.own.middle, end.own), label: end.text, colour: colour(end.own) }));
  const height = Math.max(210, Math.min(280, width * 0.5));
  spreadApart(ends, 13 * most * axis.scale * 1.12 / (height - 48), 0, most * axis.scale * 1.12);
  const marks = series.flatMap(([, own]) => seriesMarks(own, place, at_, colour(own[0])));
  const levels = without.flatMap((one) => [
    Plot.ruleY([at_(one.middle, one)], { stroke: colour(one), strokeDasharray: "6 3", strokeWidth: 1.5 }),
  ]);
  return Plot.plot({
    width, height, marginTop: 14, marginBottom: 34, marginLeft: 48, marginRight: beside + 22, style: STYLE,
    x: { ...place.scale, label: setting.title + (setting.unit ? ` (${setting.unit})` : "") },
    y: { domain: [0, most * axis.scale * 1.12 || 1], ticks: 5, tickFormat: axis.format, label: null },
    marks: [
      Plot.gridY({ stroke: "var(--rule)", strokeOpacity: 1, ticks: 5 }),
      Plot.ruleY([0], { stroke: "var(--faint)" }),
      Plot.ruleY([most * axis.scale], { stroke: "var(--faint)", strokeDasharray: "1 3" }),
      ...levels, ...marks,
      Plot.text(ends, { frameAnchor: "right", y: "place", text: "label", fill: "colour", textAnchor: "start", dx: 12, fontWeight: 500 }),
      Plot.tip(having, Plot.pointer({ x: place.of, y: (one) => at_(one.middle, one), fill: "var(--paper)", stroke: "var(--rule)", lineWidth: 22, title: arrivalTip })),
    ],
  });
}

function withoutLabel(one, across) {
  const label = labelOf(one.group, ["curriculum"]) || `no ${settingNamed(across).title}`;
  return Number.isFinite(one.middle) ? label : `${label}, not reached`;
}

function seriesMarks(own, place, at_, colour) {
  const dots = own.flatMap((one) => one.times.map((time) => ({ one, time })));
  const line = place.ordered ? [Plot.line(own, { x: place.of, y: (one) => at_(one.middle, one), stroke: colour, strokeWidth: 1.9 })] : [];
  return [
    ...line,
    Plot.ruleX(own.filter((one) => one.runs > 1), { x: place.of, y1: (one) => at_(one.low, one), y2: (one) => at_(one.high, one), stroke: colour, strokeOpacity: 0.35, strokeWidth: 4 }),
    Plot.dot(dots, { x: (d) => place.of(d.one), y: (d) => at_(d.time, d.one), r: 2, fillOpacity: 0.55, strokeOpacity: 0.55, stroke: colour,
                     fill: (d) => (Number.isFinite(d.time) ? colour : "var(--paper)") }),
    Plot.dot(own, { x: place.of, y: (one) => at_(one.middle, one), r: 4, stroke: colour, strokeWidth: 1.8,
                    fill: (one) => (Number.isFinite(one.middle) ? colour : "var(--paper)") }),
  ];
}

/** Where values stand: numbers to scale, or on a logarithmic one where they are far apart. */
function placesOf(setting, found, width) {
  const numbers = setting.values.map((value) => value.number);
  if (numbers.every(isKnown)) {
    const used = found.map((one) => valueOf(one.group, setting.name).number);
    const low = d3.min(used), high = d3.max(used);
    const wide = low > 0 && high > 30 * low;
    const values = [...new Set(used)].sort((a, b) => a - b);
    const every = Math.ceil(values.length / (width / 55));
    const ticks = values.filter((_, i) => i % every === 0);
    return { ordered: true, of: (one) => valueOf(one.group, setting.name).number,
             scale: { type: wide ? "log" : "linear", inset: 12, ticks, tickFormat: formatNumber,
                      domain: low === high ? [low - 1, high + 1] : [low, high] } };
  }
  return { ordered: false, of: (one) => textOn(one.group, setting.name),
           scale: { type: "point", domain: domainOf(found, setting.name), padding: 0.5 } };
}
