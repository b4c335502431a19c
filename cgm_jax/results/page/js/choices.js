// What the reader has chosen: kept in the address, so that a reload or a link shows the same.

const choices = {
  x: "env_steps", colour: null, panel: null, level: 50, spread: "quartiles",
  across: null, down: null, group: null, measure: null, theme: "auto", hidden: {},
};

function readChoices() {
  const found = new URLSearchParams(location.hash.slice(1));
  for (const [name, text] of found) {
    if (name === "hidden") {
      for (const part of text.split(" ")) {
        const [setting, ...values] = part.split(".");
        if (settingNamed(setting)) choices.hidden[setting] = new Set(values.map(Number));
      }
    } else if (name === "level" || name === "group") {
      const number = Number.parseInt(text, 10);
      if (Number.isFinite(number)) choices[name] = number;
    } else if (name in choices) choices[name] = text;
  }
  if (!(choices.level >= 5 && choices.level <= 100)) choices.level = 50;
  if (!report.groups[choices.group]) choices.group = null;
  if (!X_AXES[choices.x]) choices.x = "env_steps";
}

function writeChoices() {
  const written = new URLSearchParams();
  for (const [name, value] of Object.entries(choices)) {
    if (name !== "hidden" && isKnown(value)) written.set(name, value);
  }
  const hidden = Object.entries(choices.hidden)
    .filter(([, values]) => values.size).map(([name, values]) => [name, ...values].join("."));
  if (hidden.length) written.set("hidden", hidden.join(" "));
  try {
    history.replaceState(null, "", "#" + written);
  } catch { /* some viewers of files refuse; then a reload forgets */ }
}

function choose(changes) {
  Object.assign(choices, changes);
  writeChoices();
  drawAll();
}

function toggle(setting, index) {
  const hidden = (choices.hidden[setting] ??= new Set());
  if (!hidden.delete(index)) hidden.add(index);
  const left = settingNamed(setting).values.length - hidden.size;
  if (left === 0) hidden.clear();
  choose({});
}
