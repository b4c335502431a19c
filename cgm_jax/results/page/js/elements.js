// Elements of the page. Text from run directories only ever becomes text, never HTML.

const at = (id) => document.getElementById(id);

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (isKnown(value) && value !== false) made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.filter(isKnown));
  return made;
}

const capital = (text) => text[0].toUpperCase() + text.slice(1);

function segments(label, options, chosen, onchoose) {
  const buttons = options.map(([value, text]) => element("button", {
    type: "button", "aria-pressed": String(value === chosen), "data-value": value,
    onclick: () => onchoose(value),
  }, text));
  return element("div", { class: "control", role: "group", "aria-label": label }, label,
    element("span", { class: "segments" }, ...buttons));
}

function selection(label, name, options, chosen, onchoose) {
  const select = element("select", { name, onchange: () => onchoose(select.value) },
    ...options.map(([value, text]) =>
      element("option", { value, selected: String(value) === String(chosen) }, text)));
  return element("label", { class: "control" }, label, select);
}

/** A table; columns are { title, number }, rows are lists of texts. */
function table(columns, rows) {
  const kind = (i) => (columns[i].number ? "number" : null);
  return element("table", {},
    element("thead", {}, element("tr", {},
      ...columns.map((column, i) => element("th", { class: kind(i), scope: "col" }, column.title)))),
    element("tbody", {}, ...rows.map((row) =>
      element("tr", {}, ...row.map((text, i) => element("td", { class: kind(i) }, text ?? ""))))));
}

/** Entries of a key: { colour, dash, label, width }. */
function key(entries) {
  return element("ul", { class: "key" }, ...entries.map((entry) => {
    const swatch = d3.create("svg").attr("width", 24).attr("height", 10).attr("aria-hidden", "true");
    swatch.append("line").attr("x2", 24).attr("y1", 5).attr("y2", 5).attr("stroke", entry.colour)
      .attr("stroke-width", entry.width ?? 2).attr("stroke-dasharray", entry.dash ?? "none");
    return element("li", {}, swatch.node(), entry.label);
  }));
}

/** Replace what an element holds, leaving focus on the control that has it. */
function fill(container, ...children) {
  const focused = document.activeElement;
  const place = container.contains(focused)
    ? [...container.querySelectorAll("button,select,input")].indexOf(focused) : -1;
  container.replaceChildren(...children);
  if (place >= 0) container.querySelectorAll("button,select,input")[place]?.focus();
}
