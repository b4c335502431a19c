// What the reader has chosen: kept in the address, so that a reload or a link shows the same.

const choices = {
  x: "env_steps", colour: null, panel: null, level: 50, spread: "quartiles",
  across: null, down: null, group: null, measure: null, theme: "auto", hidden: {},
};

function readChoices() {
  const found = new URLSearchParams(location.hash.slice(1));
  for (const [name, text] of found) {
    if (name === "hidden") {
      hide(text);
    } else if (name === "level") {
      choices.level = Number.parseInt(text, 10);
    } else if (name in choices) choices[name] = text;
  }
  if (!(choices.level >= 5 && choices.level <= 100)) choices.level = 50;
  if (!X_AXES[choices.x]) choices.x = "env_steps";
}

/** Switch off "setting:value". Told by its text: its number changes once training adds others. */
function hide(written) {
  const end = written.indexOf(":");
  const name = written.slice(0, end), text = written.slice(end + 1);
  const index = settingNamed(name)?.values.findIndex((value) => value.text === text) ?? -1;
  if (index >= 0) (choices.hidden[name] ??= new Set()).add(index);
}

function writeChoices() {
  const written = new URLSearchParams();
  for (const [name, value] of Object.entries(choices)) {
    if (name !== "hidden" && isKnown(value)) written.set(name, value);
  }
  for (const [name, values] of Object.entries(choices.hidden)) {
    for (const index of values) written.append("hidden", `${name}:${settingNamed(name).values[index].text}`);
  }
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
