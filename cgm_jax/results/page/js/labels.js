// Settings of groups: a group is the runs that differ in the seed only.

const settingIndex = (name) => report.settings.findIndex((setting) => setting.name === name);
const settingNamed = (name) => report.settings[settingIndex(name)];

/** Number of a group's value of a setting; null if it does not have the setting. */
const valueIndex = (group, name) => group.values[settingIndex(name)];

function valueOf(group, name) {
  const index = valueIndex(group, name);
  return isKnown(index) ? settingNamed(name).values[index] : null;
}

const runsOf = (group) => group.runs.map((index) => report.runs[index]);

/** Groups none of whose values has been switched off. */
function shownGroups() {
  return report.groups.filter((group) =>
    report.settings.every((setting, i) => !choices.hidden[setting.name]?.has(group.values[i])));
}

/** Settings that tell groups apart; those between sweeps are told by the sweep. */
const tellingSettings = () => report.settings.filter((setting) => !setting.between).map((s) => s.name);

/** Settings in which these groups differ. */
function differingIn(groups, names) {
  return names.filter((name) =>
    new Set(groups.map((group) => valueIndex(group, name)).filter(isKnown)).size > 1);
}

function labelOf(group, names) {
  return names.map((name) => valueOf(group, name)?.label).filter(isKnown).join(", ");
}

/** All that tells a group; the run's name where nothing does. */
function fullLabel(group) {
  const label = labelOf(group, tellingSettings());
  const twins = report.groups.filter((other) => String(other.values) === String(group.values));
  const name = runsOf(group)[0].name;
  if (twins.length > 1) return label ? `${label}, ${name}` : name;
  return label || (report.groups.length > 1 ? name : "all runs");
}

const compareValues = (a, b) => {
  for (let i = 0; i < a.length; i++) {
    if (a[i] !== b[i]) return (a[i] ?? Infinity) - (b[i] ?? Infinity);
  }
  return 0;
};

const inOrder = (groups) => [...groups].sort((a, b) => compareValues(a.values, b.values));

/** Spread groups over panels; groups without a setting join the panels of those that have it. */
function panelsBy(groups, names) {
  const keyOf = (group) => names.map((name) => valueIndex(group, name));
  const fits = (own, other) => own.every((value, i) => !isKnown(value) || value === other[i]);
  const unique = new Map(groups.map((group) => [String(keyOf(group)), keyOf(group)]));
  const keys = [...unique.values()];
  const apart = keys.filter((key) => !keys.some((other) => other !== key && fits(key, other)));
  return apart.sort(compareValues).map((key) => {
    const own = groups.filter((group) => fits(keyOf(group), key));
    const having = own.find((group) => String(keyOf(group)) === String(key));
    return { title: labelOf(having, names), groups: inOrder(own) };
  });
}

const countRuns = (number) => `${number} run${number === 1 ? "" : "s"}`;
