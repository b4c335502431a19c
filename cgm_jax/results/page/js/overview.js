// The head of the page, and what its sweeps were asked for.

function drawHead() {
  const { sweeps, runs } = report;
  const seeds = [...new Set(report.groups.map((group) => group.runs.length))].sort((a, b) => a - b);
  const planned = d3.sum(sweeps, (sweep) => sweep.planned);
  const training = sweeps.filter((sweep) => !sweep.finished);
  const failed = d3.sum(sweeps, (sweep) => sweep.failed);
  at("subtitle").textContent = sweeps.map((sweep) => sweep.path).join(" · ");
  const done = d3.sum(runs, (run) => run.columns.epoch.at(-1)), all = d3.sum(runs, (run) => run.epochs ?? run.columns.epoch.at(-1));
  const settings = report.groups.length;
  const cards = [
    [runs.length.toLocaleString("en"), planned > runs.length ? `of ${planned} runs begun` : runs.length === 1 ? "run" : "runs"],
    [settings.toLocaleString("en"), `setting${settings === 1 ? "" : "s"}, ${seeds.length > 1 ? `${seeds[0]} to ${seeds.at(-1)}` : seeds[0] ?? 0} seed${seeds.at(-1) === 1 ? "" : "s"} each`],
    [d3.format(".3~s")(d3.sum(sweeps, (sweep) => sweep.env_steps)), "environment steps in all"],
    training.length ? [`${Math.floor(100 * done / (all || 1))} %`, "of the epochs of runs begun"] : ["finished", "no run is left to train"],
    ...(failed ? [[`${failed}`, `run${failed === 1 ? "" : "s"} diverged, marked by crosses`]] : []),
  ];
  at("cards").replaceChildren(...cards.map(([number, text]) =>
    element("div", { class: "card" }, element("b", {}, number), element("span", {}, text))));
  at("footer").textContent = `Made by cgm_jax ${report.version} on ${report.made.replace("T", " ").replace("+00:00", " UTC")}. ` +
    "Drawn with Observable Plot and D3 (ISC licence).";
}

function drawSweeps() {
  const { sweeps } = report;
  const columns = ["", ...sweeps.map((sweep) => sweep.label)].map((title) => ({ title }));
  const facts = [["directory", "path"], ["started", "started"], ["preset", "preset"], ["commit", "commit"], ["machine", "machine"], ["command", "command"]];
  const rows = facts.map(([title, name]) => [title, ...sweeps.map((sweep) =>
    isKnown(sweep[name]) ? (name === "command" ? element("code", {}, sweep[name]) : sweep[name]) : "–")]);
  rows.push(["runs", ...sweeps.map((sweep) => `${sweep.runs} of ${sweep.planned}` + (sweep.finished ? ", finished" : ", training or stopped"))]);
  const differ = report.differences.map(({ title, values }) => [title, ...values]);
  const several = sweeps.length > 1;
  at("sweeps-caption").textContent = several ? "What differs between these sweeps, or is varied within one." : "What this sweep varies, and what it was begun with.";
  const scrolled = (made) => element("div", { class: "scroll" }, made);
  const failed = report.runs.filter((run) => run.failed);
  at("sweeps-tables").replaceChildren(
    ...(differ.length ? [element("h3", {}, several ? "Differs" : "Varied"), scrolled(table(columns, differ))] : []),
    element("h3", {}, several ? "Sweeps" : "Sweep"), scrolled(table(columns, rows)),
    ...(failed.length ? [element("h3", {}, "Diverged"), scrolled(table(
      [{ title: "Run" }, { title: "Sweep" }, { title: "Epoch", number: true }, { title: "Failure" }],
      failed.map((run) => [run.name, sweeps[run.sweep].label, String(run.failed.epoch), run.failed.text])))] : []),
    element("details", {}, element("summary", {}, `All other settings (${report.common.length})`),
      scrolled(table([{ title: "Setting" }, { title: "Value" }], report.common))));
  at("videos").hidden = !document.querySelector(".videos figure");
}
