/* The page on which a person draws labels in the photograph. Positions are px; a pixel's centre is whole. */
"use strict";

/** Colours of labels by their number, distinct in all common colour vision deficiencies. */
const COLOURS = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#cc79a7", "#d55e00", "#0072b2"];
const colourOf = (label) => (label === 0 ? "#ffffff" : COLOURS[(label - 1) % COLOURS.length]);

/** Name of the label whose pixels nothing uses. */
const EXCLUDED = "excluded";

const page = {
  names: [], // {label, name, column}
  own: null, // labels of the capture's own image, pixel by pixel; null without
  shapes: [], // {label, corners}, later ones over earlier ones
  undone: [], // shapes that Redo brings back
  corners: [], // of the unfinished shape
  cursor: null, // position of the keyboard's cross
  chosen: 0, // label to draw; 0 cuts pixels out
  counts: new Map(), // by label: {pixels, inside}
  asking: 0, // number of the newest question; older answers are dropped
};

const ask = asker("labels");

const tool = () => document.querySelector("input[name=tool]:checked").value;
const drawing = () => ({ shapes: page.shapes, base: page.own !== null });

const show = () => attempt(async () => {
  const { width, height, photograph: values, labels, names } = await ask("picture");
  Object.assign(page, { names, shapes: [], undone: [], corners: [], cursor: null });
  page.own = await decoded(labels);
  page.chosen = names.length ? names[0].label : 0;
  $("work").hidden = false;
  photograph.show(width, height, await decoded(values));
  await count();
});

/** Pixels of each label, for the shapes as they are. */
async function count() {
  const number = ++page.asking;
  const { counts } = await ask("count", drawing());
  if (number !== page.asking) return;
  page.counts = new Map(counts.map((each) => [each.label, each]));
  list();
}

const changed = () => {
  refresh();
  return attempt(count);
};

function refresh() {
  $("undo").disabled = !page.shapes.length && !page.corners.length;
  $("redo").disabled = !page.undone.length;
  $("close").disabled = page.corners.length < 3 || tool() !== "polygon";
  $("progress").textContent = page.corners.length ? `${page.corners.length} corners of an unfinished ${tool()}.` : "";
  photograph.draw();
}

function finish(corners) {
  page.shapes.push({ label: page.chosen, corners });
  page.corners = [];
  page.undone = [];
  changed();
}

/** Add a corner to the unfinished shape; the second one of a rectangle ends it. */
function add(position) {
  const [u, v] = photograph.inside(position);
  if (tool() === "rectangle" && page.corners.length) {
    const [a, b] = page.corners[0];
    if (a === u || b === v) return;
    finish([[a, b], [u, b], [u, v], [a, v]]);
    return;
  }
  page.corners.push([u, v]);
  refresh();
}

function undo() {
  if (page.corners.length) {
    page.corners.pop();
    refresh();
  } else if (page.shapes.length) {
    page.undone.push(page.shapes.pop());
    changed();
  }
}

function redo() {
  if (!page.undone.length) return;
  page.shapes.push(page.undone.pop());
  changed();
}

function close() {
  if (page.corners.length > 2 && tool() === "polygon") finish(page.corners);
}

function list() {
  const nameless = [...page.counts.keys()].filter((label) => !page.names.some((row) => row.label === label));
  const every = [{ label: 0, name: "no label", column: "" }, ...page.names,
    ...nameless.map((label) => ({ label, name: "without a name, not measured", column: "" }))];
  const rows = every.map(({ label, name, column }) => {
    const input = make("input", { type: "radio", name: "label", value: label });
    input.checked = label === page.chosen;
    input.addEventListener("change", () => { page.chosen = label; refresh(); });
    const { pixels, inside } = page.counts.get(label) || { pixels: 0, inside: 0 };
    const size = label === 0 ? "" : name === EXCLUDED ? `: ${pixels} px that no comparison and no fit uses` : `: ${pixels} px, ${inside} px without a rim of 4 px${inside < 20 ? " (calibration needs 20)" : ""}`;
    const swatch = make("span", { class: "swatch", "aria-hidden": "true" });
    swatch.style.background = colourOf(label);
    return make("label", { class: "check" }, [input, swatch,
      make("span", {}, `${label} ${name}${column ? `, ${column}` : ""}${size}`)]);
  });
  $("labels").replaceChildren(...rows);
}

function drawOver(context, at) {
  const outlined = (corners) => (c) => {
    corners.forEach((corner, i) => (i ? c.lineTo(...at(...corner)) : c.moveTo(...at(...corner))));
  };
  if (page.own) {
    context.globalAlpha = 0.4;
    page.own.forEach((label, i) => {
      if (!label) return;
      const [u, v] = [i % photograph.width, Math.floor(i / photograph.width)];
      context.fillStyle = colourOf(label);
      context.fillRect(...at(u - 0.5, v - 0.5), photograph.zoom, photograph.zoom);
    });
    context.globalAlpha = 1;
  }
  for (const { label, corners } of page.shapes) {
    context.globalAlpha = 0.4;
    context.fillStyle = label ? colourOf(label) : "#000";
    context.beginPath();
    outlined(corners)(context);
    context.fill("evenodd");
    context.globalAlpha = 1;
    stroked(context, colourOf(label), (c) => { outlined(corners)(c); c.closePath(); });
  }
  if (page.corners.length) stroked(context, "#fff", outlined(page.corners));
  for (const corner of page.corners) cross(context, at(...corner), "#fff", 5);
  if (page.cursor) cross(context, at(...page.cursor), colourOf(page.chosen), 9);
}

const photograph = new Photograph($("picture"),
  "Photograph. Arrow keys move a cross by 1 px, with Shift by 8 px. Enter adds a corner there, C closes a polygon, " +
  "Escape drops the unfinished shape, Control Z undoes, Control Y brings back.", drawOver);

photograph.canvas.addEventListener("click", (event) => add(photograph.at(event)));
photograph.canvas.addEventListener("keydown", (event) => {
  const step = arrowStep(event, 1, 8);
  if (step) {
    const [u, v] = page.cursor || [(photograph.width - 1) / 2, (photograph.height - 1) / 2];
    page.cursor = photograph.inside([u + step[0], v + step[1]]);
    $("progress").textContent = `Cross at ${page.cursor.map((x) => x.toFixed(1)).join(", ")} px.`;
    photograph.draw();
  } else if (event.key === "Enter" && page.cursor) add(page.cursor);
  else if (event.key === "c" && !event.ctrlKey) close();
  else if (event.key === "Escape") {
    page.corners = [];
    refresh();
  } else return;
  event.preventDefault();
});
document.addEventListener("keydown", (event) => {
  if (!event.ctrlKey || event.target.matches("input:not([type=radio])")) return;
  const does = { z: undo, y: redo }[event.key];
  if (!does) return;
  event.preventDefault();
  does();
});
for (const input of document.querySelectorAll("input[name=tool]"))
  input.addEventListener("change", () => { page.corners = []; refresh(); });
$("which").addEventListener("submit", (event) => { event.preventDefault(); show(); });
$("undo").addEventListener("click", undo);
$("redo").addEventListener("click", redo);
$("close").addEventListener("click", close);
const NUMBERS = Array.from({ length: 255 }, (_, k) => k + 1);
const isFree = (label) => !page.names.some((row) => row.label === label);
$("exclude").addEventListener("click", () => {
  if (!page.names.some((row) => row.name === EXCLUDED))
    page.names.push({ label: NUMBERS.findLast(isFree), name: EXCLUDED, column: "" });
  page.chosen = page.names.find((row) => row.name === EXCLUDED).label;
  list();
  refresh();
});
$("new").addEventListener("submit", (event) => {
  event.preventDefault();
  const label = $("number").value.trim() === "" ? NUMBERS.find(isFree) : Number($("number").value);
  const name = $("name").value.trim();
  const fault = !Number.isInteger(label) || label < 1 || label > 255 ? "The number of a label is whole, from 1 to 255."
    : !isFree(label) ? `Label ${label} exists already.`
      : name ? "" : "A label needs a name.";
  $("mistake").textContent = fault;
  if (fault) return;
  page.names.push({ label, name, column: $("column").value.trim() });
  page.chosen = label;
  for (const id of ["number", "name", "column"]) $(id).value = "";
  list();
  refresh();
});
$("chart").addEventListener("click", () => attempt(async () => {
  const { shapes } = await ask("chart");
  page.shapes.push(...shapes);
  page.undone = [];
  for (const { label } of shapes)
    if (!page.names.some((row) => row.label === label)) page.names.push({ label, name: `patch ${label}`, column: "" });
  refresh();
  await count();
}));
$("write").addEventListener("click", () => attempt(async () => {
  const body = { ...drawing(), names: page.names };
  let written = await ask("write", body);
  if (written.exists) {
    if (!confirm(`These files exist already: ${written.exists.join(", ")}. Replace them?`)) return;
    written = await ask("write", { ...body, replace: true });
  }
  const text = written.lines.replaceAll("\n", " ");
  const manifest = written.added ? ` Added to capture.toml: ${text}.` : text ? ` capture.toml needs: ${text}.` : "";
  $("saved").textContent = `Written: ${written.paths.join(", ")}.${manifest}`;
}));
attempt(async () => {
  const found = await (await fetch("api/places")).json();
  $("captures").replaceChildren(...found.captures.map((name) => make("option", { value: name })));
  const asked = new URLSearchParams(location.search).get("capture");
  $("capture").value = asked || found.captures[0] || "";
  if (asked) await show();
});
