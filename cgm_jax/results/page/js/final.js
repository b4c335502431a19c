// Final success: every run with Wilson's interval, and the median over seeds.

function drawFinal() {
  const groups = inOrder(shownGroups());
  const finals = groups.flatMap(runsOf).map((run) => run.final);
  const short = finals.some((final) => final.evaluations < report.holding);
  at("final-caption").textContent =
    `Mean of the last ${report.holding} evaluations${short ? ", or of as many as there are" : ""}. Dots are runs; their bars are Wilson's 95 % interval over the episodes ` +
    "of these evaluations, which says how well a run's policies are known and nothing of other seeds." +
    (groups.some((group) => group.runs.length > 1) ? " Ticks are medians over seeds" +
      (groups.some((group) => isKnown(group.final.low)) ? "; the shaded interval is the median's, 95 %, whatever the distribution."
        : "; fewer than six seeds allow no 95 % interval of a median.") : "") +
    (finals.some((final) => final.never_valid) ? " Open dots are runs without a valid episode, which counts as no success." : "");
  const left = groups.flatMap(runsOf).filter(leftEarly);
  if (left.length) {
    const levels = [...new Set(left.map((run) => percent(run.leave_at)))].join(" or ");
    at("final-caption").textContent += ` ${countRuns(left.length)} could leave training on holding ${levels}, and did or were stopped: what they would have reached is not known.`;
  }
  const host = at("final-chart");
  stopObserving(host);
  const body = element("div");
  host.replaceChildren(element("figure", { class: "panel" }, body));
  fitted(body, "Final success of every run", (width) => finalChart(groups, width));
  at("final-table").replaceChildren(table(
    [{ title: "Setting" }, { title: "Run" }, { title: "Success", number: true }, { title: "95 % interval", number: true }, { title: "Episodes", number: true }],
    groups.flatMap((group) => runsOf(group).map((run) => [
      fullLabel(group), run.name, run.final.never_valid ? "no valid episode" : percent(run.final.rate),
      isKnown(run.final.low) ? `${percent(run.final.low)} to ${percent(run.final.high)}` : "–",
      isKnown(run.final.episodes) ? String(run.final.episodes) : "–"]))));
}

function finalChart(groups, width) {
  const labels = new Map(groups.map((group) => [group, fullLabel(group)]));
  const longest = Math.max(...groups.map((group) => textWidth(labels.get(group))));
  const inside = longest > width * 0.4;  // labels above their rows, where they would take too much beside
  const step = inside ? 40 : 26, half = inside ? 0.2 : 0.36;
  const rows = new Map(groups.map((group, i) => [group, i]));
  const dots = groups.flatMap((group) => runsOf(group).map((run, i) => {
    const count = group.runs.length;
    return { group, run, ...run.final, y: rows.get(group) + (count > 1 ? (i / (count - 1) - 0.5) * Math.min(1.4 * half, 0.1 * (count - 1)) : 0) };
  }));
  const margin = inside ? 8 : longest + 16;
  return Plot.plot({
    width, height: groups.length * step + 52, marginLeft: margin, marginTop: 10, marginBottom: 36, marginRight: 14, style: STYLE,
    x: { domain: [0, 1], tickFormat: formatPercent, label: "success rate, full goal (%)", ticks: Math.max(3, Math.round(width / 110)) },
    y: { domain: [-0.6, groups.length - 0.4], reverse: false, axis: null, type: "linear", range: [10, groups.length * step + 16] },
    marks: [
      Plot.gridX({ stroke: "var(--rule)", strokeOpacity: 1 }),
      Plot.rect(groups.filter((group) => isKnown(group.final.low)), {
        x1: (group) => group.final.low, x2: (group) => group.final.high, y1: (group) => rows.get(group) - 0.9 * half,
        y2: (group) => rows.get(group) + 0.9 * half, fill: colourOf, fillOpacity: 0.16 }),
      Plot.link(dots.filter((dot) => isKnown(dot.low)), { x1: "low", x2: "high", y1: "y", y2: "y",
        stroke: (dot) => colourOf(dot.group), strokeOpacity: 0.35, strokeWidth: 1.2 }),
      Plot.dot(dots.filter((dot) => !dot.run.failed), { x: "rate", y: "y", r: 3, stroke: (dot) => colourOf(dot.group),
        fill: (dot) => (dot.never_valid ? "var(--paper)" : colourOf(dot.group)) }),
      Plot.dot(dots.filter((dot) => dot.run.failed), { x: "rate", y: "y", r: 4.5, symbol: "times", strokeWidth: 1.8, stroke: (dot) => colourOf(dot.group) }),
      Plot.link(groups.filter((group) => group.runs.length > 1), {
        x1: (group) => group.final.median, x2: (group) => group.final.median, y1: (group) => rows.get(group) - half,
        y2: (group) => rows.get(group) + half, stroke: "var(--ink)", strokeWidth: 2 }),
      Plot.text(groups, { x: 0, y: (group) => rows.get(group), text: (group) => labels.get(group), textAnchor: inside ? "start" : "end",
        dx: inside ? 0 : -10, dy: inside ? -15 : 0, fill: "var(--ink)" }),
      Plot.tip(dots, Plot.pointer({ x: "rate", y: "y", fill: "var(--paper)", stroke: "var(--rule)", lineWidth: 22, title: (dot) =>
        [labels.get(dot.group), `seed ${dot.run.seed}: ${dot.never_valid ? "no valid episode" : percent(dot.rate)}` +
          (isKnown(dot.low) ? `  (${percent(dot.low)} to ${percent(dot.high)}, ${dot.episodes} episodes)` : ""),
         dot.run.failed ? `diverged in epoch ${dot.run.failed.epoch}: ${dot.run.failed.text}` : null].filter(isKnown).join("\n") })),
    ],
  });
}
