// Colours by the value of one setting: ordered ones on a scale, others apart; dashes for the rest.

const CATEGORIES = 6;
const SHADES = 64;
const DASHES = ["none", "6 3", "2 3", "8 3 2 3"];

/** Make the colours of ordered values, dark enough on paper and light enough on black. */
function definePalette() {
  const rule = (from, to) => d3.range(SHADES).map((i) =>
    `--scale-${i}: ${d3.interpolateViridis(from + (to - from) * i / (SHADES - 1))};`).join("");
  const style = document.createElement("style");
  style.textContent = `:root{${rule(0.03, 0.74)}${heatRule("#e3edf7", "#08407c", "#101318", "#ffffff")}}` +
    `@media not print{:root[data-theme="dark"]{${rule(0.36, 1)}${heatRule("#1c2b3a", "#a9d8ff", "#eceef1", "#101318")}}}`;
  document.head.append(style);
}

const HEATS = 12;

/** Shades of heat maps from weak to strong, each with the ink that is read best on it. */
function heatRule(weak, strong, inkOnWeak, inkOnStrong) {
  const mix = d3.interpolateLab(weak, strong);
  return d3.range(HEATS).map((i) => {
    const shade = mix(i / (HEATS - 1));
    const far = (ink) => Math.abs(d3.lab(ink).l - d3.lab(shade).l);
    const ink = far(inkOnWeak) > far(inkOnStrong) ? inkOnWeak : inkOnStrong;
    return `--heat-${i}: ${shade}; --heat-ink-${i}: ${ink};`;
  }).join("");
}

/** Step of a share in [0, 1] in the shades of heat maps. */
const heatStep = (share) => Math.min(HEATS - 1, Math.max(0, Math.floor(share * HEATS)));

const shadeOf = (index, count) =>
  `var(--scale-${count < 2 ? 0 : Math.round((SHADES - 1) * index / (count - 1))})`;

/** Whether a setting's values have shades of a scale, and not colours of their own. */
function isScaled(setting) {
  const ordered = setting.values.every((value) => isKnown(value.number));
  return setting.values.length > CATEGORIES || (ordered && setting.values.length > 2);
}

function valueColour(setting, index) {
  if (isScaled(setting)) return shadeOf(index, setting.values.length);
  if (setting.name === "curriculum" && setting.values[index].text === "full goals") return "var(--ink)";
  return `var(--series-${index})`;
}

/** A group's colour; one without the setting has that of its curriculum. */
function colourOf(group) {
  const setting = settingNamed(choices.colour);
  if (!setting) return "var(--series-0)";
  const index = valueIndex(group, setting.name);
  if (isKnown(index)) return valueColour(setting, index);
  const curriculum = settingNamed("curriculum");
  const own = curriculum && valueIndex(group, "curriculum");
  if (!isKnown(own) || curriculum.values[own].text === "full goals") return "var(--ink)";
  const spare = isScaled(setting) ? [1, 3, 4] : d3.range(setting.values.length, CATEGORIES);
  return spare.length ? `var(--series-${spare[own % spare.length]})` : "var(--soft)";
}

/** Lines of a panel: their groups with a colour, a dash and a label that tell them apart. */
function linesOf(groups) {
  const differ = differingIn(groups, tellingSettings());
  const counts = new Map(), crowded = isCrowded(groups);
  return groups.map((group, i) => {
    const colour = crowded ? shadeOf(i, groups.length) : colourOf(group);
    const seen = counts.get(colour) ?? 0;
    counts.set(colour, seen + 1);
    const names = differ.filter((name) => name !== "curriculum" || !impliesCurriculum(group, groups));
    return { group, colour, dash: DASHES[seen % DASHES.length],
             label: lineLabel(group, groups, names) };
  });
}

/** Whether more lines of a panel have one colour than dashes could tell apart. */
const isCrowded = (groups) => Math.max(0, ...d3.rollup(groups, (same) => same.length, colourOf).values()) > DASHES.length;

function lineLabel(group, groups, names) {
  const label = labelOf(group, names);
  const same = groups.filter((other) => labelOf(other, names) === label);
  return same.length > 1 ? fullLabel(group) : label;
}

/** Whether the colour's setting alone tells a group's curriculum. */
function impliesCurriculum(group, groups) {
  const name = choices.colour;
  if (!name || name === "curriculum" || !isKnown(valueIndex(group, name))) return false;
  const having = groups.filter((other) => isKnown(valueIndex(other, name)));
  return new Set(having.map((other) => valueIndex(other, "curriculum"))).size === 1;
}
