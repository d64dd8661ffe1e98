/* The page that makes a capture.toml of a folder of frames. The server has the entries; the page sends each change. */
"use strict";

const $ = (id) => document.getElementById(id);

const page = { form: null, shape: "", asking: 0, working: 0, last: null, folder: "", fields: 0 };

/** Groups of frames, by kind of table: title, and what they are for. */
const KINDS = {
  band: ["Photographs of the box", "One row is one exposure through one filter. Its frames are repeats."],
  bracket: ["Further exposures of these", "Other exposures through the same filter. They are merged."],
  dark: ["Dark frames", "Taken with the lens covered, at the exposures of the other frames."],
  flat: ["Flat fields", "Even light through each filter: they correct the fall-off towards the corners."],
  reference: ["Source of known radiance", "It gives the absolute scale."],
  target: ["Printed board", "It gives the camera and its distortion."],
  none: ["Frames that are not used", "Tick one and say what it is, if it belongs to the capture."],
};

/** Groups of other values, by table: title, and what is not done without them. */
const OTHERS = {
  "the top, above all tables": ["The box", "Without a scene the photographs are calibrated, and compared with nothing."],
  "[camera]": ["Camera", "From its data sheet."],
  "[lens]": ["Lens", "For the absolute scale, and a first guess of where the camera stood."],
  "every [[band]]": ["All photographs", "One value for all of them."],
  "[lamp]": ["Lamp", "Without its spectrum nothing is compared with a rendering."],
  "[geometry]": ["Surveyed points", "Without them no camera is found. Have you no points.csv? Leave this empty, write " +
    "capture.toml with a scene, and mark corners in the photograph then."],
};

/** Short names of values that rows of frames lack, above their fields. */
const SHORT = { exposure_s: "Exposure, s", start_s: "Start, s", transmittance: "Transmittance" };

async function ask(name, body = {}) {
  let answer;
  try {
    answer = await fetch("api/first/" + name, {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ folder: page.folder, ...body }),
    });
  } catch {
    throw new Error("The program does not answer. Start `cbox studio` again: what you entered before is stored.");
  }
  const record = await answer.json();
  if (!answer.ok) throw new Error(record.error);
  return record;
}

async function attempt(step) {
  $("mistake").textContent = $("saved").textContent = "";
  page.working += 1;
  document.body.dataset.busy = "true";
  try {
    await step();
  } catch (error) {
    $("mistake").textContent = error.message;
  }
  page.working -= 1;
  document.body.dataset.busy = String(page.working > 0);
}

/** Entries that the server has not answered yet, by field: they are sent again with the next one. */
const unsent = new Map();

/** Send changes, and show the form with them; an answer that a later one overtook is not shown. */
async function send(entries = [], roles = []) {
  const number = ++page.asking;
  for (const entry of entries) unsent.set(fieldName(entry), entry);
  const sent = [...unsent];
  const form = await ask("draft", { entries: sent.map(([, entry]) => entry), roles });
  for (const [name, entry] of sent) if (unsent.get(name) === entry) unsent.delete(name);
  if (number === page.asking) await show(form);
}

const fieldName = ({ where, key }) => `${where} ${key}`;
const inputs = () => [...document.querySelectorAll("input[data-key]")];
const capital = (text) => text[0].toUpperCase() + text.slice(1);
const plain = (example) => example.replace(/^"(.*)"$/, "$1");

/** List of names that a field offers. */
function listOf({ key, example }) {
  if (key === "scene") return "offered-scene";
  if (/^"[^"]*\.csv:/.test(example)) return "offered-column";
  return /^"[^"]*\.csv"$/.test(example) ? "offered-table" : "";
}

/** What a value is, in words: title, and what else is to be said. */
function wordsOf({ key, why }) {
  const [first, ...rest] = why.split("; ");
  const title = first.replace(/\bum\b/, "µm");
  return [capital(first.startsWith("of the ") ? `${key.replaceAll("_", " ")} ${title}` : title), rest];
}

/** A field of a missing value; its entry is checked when it is left. `of` is the row's name, for a screen reader. */
function fieldOf(field, of) {
  const { where, key, example, required } = field, [words, rest] = wordsOf(field);
  const title = of ? SHORT[key] ?? words : words;
  const fault = make("p", { id: `fault-${++page.fields}` });
  const input = make("input", {
    placeholder: plain(example), autocomplete: "off", maxlength: 300, "data-key": key, "data-where": where, title: `${where}: ${key}`,
    "aria-describedby": fault.id, ...(listOf(field) ? { list: listOf(field) } : {}), ...(required ? { "aria-required": "true" } : {}),
  });
  input.addEventListener("change", () => {
    const isNumber = Number.isFinite(Number(example));
    if (isNumber) input.value = input.value.trim().replace(/^(-?\d+),(\d+)$/, "$1.$2");
    page.last = fieldName(field);
    attempt(() => send([{ where, key, value: input.value }]));
  });
  const repeat = make("button", { type: "button", class: "small", hidden: "" });
  repeat.addEventListener("click", () => {
    const alike = alikeOf(input);
    page.last = null;
    alike[0]?.focus();
    attempt(() => send(alike.map((other) => ({ where: other.dataset.where, key, value: input.value }))));
  });
  const label = [make("strong", {}, title), ...(required ? [" ", make("em", {}, "required")] : [])];
  const further = of ? [] : [make("span", {}, [...rest, `such as ${plain(example)}`].join("; "))];
  if (of) input.setAttribute("aria-label", `${title}, ${of}${required ? ", required" : ""}`);
  return make("div", { class: of ? "field" : "field wide" }, [make("label", {}, [make("span", {}, label), ...further, input]), repeat, fault]);
}

/** Empty fields of the same key in the same group of frames. */
const alikeOf = (input) => inputs().filter((other) => other !== input && !other.value &&
  other.dataset.key === input.dataset.key && other.dataset.where.split(" ")[0] === input.dataset.where.split(" ")[0]);

const tickOf = (frames) => make("input", { type: "checkbox", "data-frames": JSON.stringify(frames) });

/** The frames of a row, each with a tick, to take one out of it; its pictures, on one scale, come when it is opened. */
function singlesOf(title, frames, ofRow) {
  const ticks = frames.map((name) => tickOf([name]));
  const labels = frames.map((name, k) => make("label", { class: "frame" }, [ticks[k], make("span", {}, [name, make("small")])]));
  const singles = make("details", { class: "singles" }, [make("summary", { "aria-label": `Single frames of ${title}` }, "Single frames"), ...labels]);
  singles.addEventListener("toggle", () => attempt(async () => {
    const { thumbnails } = await ask("thumbnails", { frames });
    for (const [k, label] of labels.entries()) {
      const thumbnail = thumbnails[frames[k]];
      if (!thumbnail) continue;
      label.lastElementChild.before(await pictureOf(thumbnail, frames[k]));
      label.querySelector("small").textContent = countsOf(thumbnail);
    }
  }), { once: true });
  const follow = () => {
    const count = ticks.filter((tick) => tick.checked).length;
    ofRow.checked = count === ticks.length;
    ofRow.indeterminate = count > 0 && !ofRow.checked;
  };
  for (const tick of ticks) tick.addEventListener("change", follow);
  ofRow.addEventListener("change", () => { for (const tick of ticks) tick.checked = ofRow.checked; });
  return singles;
}

/** A row of frames: tick, small picture, name, and the fields of its missing values. */
function rowOf({ name, frames, fields, why }) {
  const tick = tickOf(frames);
  const title = name || frames[0];
  const list = frames.length > 1 ? `${frames.length} × ${frames.slice(0, 3).join(", ")}${frames.length > 3 ? ", …" : ""}` : frames[0];
  const words = make("span", {}, [title, make("small", {}, why ? why.split(": ")[0] : list)]);
  return make("div", { class: "entry" }, [
    make("label", { class: "frame", "data-frame": frames[0] }, [tick, words]), ...fields.map((field) => fieldOf(field, title)),
    ...(frames.length > 1 ? [singlesOf(title, frames, tick)] : [])]);
}

/** Rows of a kind, one for the channels of a mosaic, which have the same frames. */
function rowsOf(rows) {
  const byFrames = new Map();
  for (const row of rows) {
    const same = byFrames.get(String(row.frames));
    if (same) same.name += `, ${row.name}`;
    else byFrames.set(String(row.frames), { ...row });
  }
  return [...byFrames.values()];
}

/** What the values of some rows are that their short names do not say, each value once. */
const explained = (rows) => [...new Set(rows.flatMap((row) => row.fields).filter(({ key }) => key !== "exposure_s").map((field) =>
  ` ${SHORT[field.key] ?? field.key}: ${[wordsOf(field)[0], ...wordsOf(field)[1]].join("; ")}.`))].join("");

function groupOf(title, words, children) {
  const isBare = children.every((child) => !child.querySelector(".field") && child.matches(".entry"));
  return make("div", { class: "group", role: "group", "aria-label": title }, [
    make("h3", {}, title), make("p", { class: "soft" }, words), make("div", isBare ? { class: "bare" } : {}, children)]);
}

/** Title of the group of a table. */
const titleOf = (where) => (KINDS[where.replace(/[[\]]/g, "")] ?? OTHERS[where] ?? [where])[0];

/** Show a form; fields are replaced only where other ones are missing now. */
async function show(form) {
  page.form = form;
  const unused = form.left_out.filter((item) => item.is_frame).map(({ file, why }) => ({ kind: "none", name: file, frames: [file], fields: [], why }));
  const rows = [...form.rows, ...unused];
  const every = [...form.rows.flatMap((row) => row.fields), ...form.fields];
  const shape = JSON.stringify([rows.map(({ kind, name, frames, why }) => [kind, name, frames, why]), every.map(fieldName)]);
  const isNew = shape !== page.shape;
  if (isNew) {
    page.shape = shape;
    const ofKind = (kind) => rows.filter((row) => row.kind === kind);
    $("rows").replaceChildren(...Object.entries(KINDS).filter(([kind]) => ofKind(kind).length)
      .map(([kind, [title, words]]) => groupOf(title, words + explained(ofKind(kind)), rowsOf(ofKind(kind)).map(rowOf))));
    const tables = [...new Set(form.fields.map((field) => field.where))];
    const order = [...Object.keys(OTHERS), ...tables.filter((where) => !(where in OTHERS))].filter((where) => tables.includes(where));
    $("others").replaceChildren(...order.map((where) => groupOf(...(OTHERS[where] ?? [where, ""]),
      form.fields.filter((field) => field.where === where).map((field) => fieldOf(field, "")))));
    $("notes").replaceChildren(...form.notes.map(({ where, why }) => make("li", {}, `${titleOf(where)}: ${why}`)));
    const others = form.left_out.filter((item) => !item.is_frame);
    $("left-out").replaceChildren(...others.map(({ file, why }) => make("li", {}, `${file}: ${why}`)));
    $("unused").hidden = others.length === 0;
    for (const [name, values] of Object.entries(form.offered))
      $(`offered-${name}`).replaceChildren(...values.map((value) => make("option", { value })));
    countTicks();
  }
  const byName = new Map(every.map((field) => [fieldName(field), field]));
  for (const input of inputs()) {
    const field = byName.get(`${input.dataset.where} ${input.dataset.key}`);
    if (input !== document.activeElement || isNew) input.value = unsent.get(fieldName(field))?.value ?? field.value;
    input.setAttribute("aria-invalid", String(Boolean(field.fault)));
    document.getElementById(input.getAttribute("aria-describedby")).textContent = field.fault ?? "";
    const count = alikeOf(input).length, button = input.closest(".field").querySelector("button");
    button.hidden = !(page.last === fieldName(field) && field.value && !field.fault && count);
    button.textContent = `The same in ${count} empty ${count === 1 ? "field" : "fields"}`;
  }
  const wrong = every.filter((field) => field.fault).length + form.faults.length;
  const lacking = form.lacking ? `${form.lacking} required ${form.lacking === 1 ? "value is" : "values are"} missing` : "No required value is missing";
  $("lacking").textContent = `${lacking}. ${wrong ? `${wrong} ${wrong === 1 ? "entry is" : "entries are"} wrong.` : "Nothing that you entered is wrong."}`;
  $("faults").replaceChildren(...form.faults.map((text) => make("li", {}, text)));
  $("next").hidden = !form.lacking && !every.some((field) => field.fault);
  $("text").textContent = form.text;
  $("form").hidden = false;
  if (isNew) await showPictures();
}

async function showPictures() {
  const { shape } = page;
  const { thumbnails } = await ask("thumbnails");
  if (shape !== page.shape) return;
  for (const label of document.querySelectorAll("label.frame[data-frame]")) {
    const thumbnail = thumbnails[label.dataset.frame];
    if (thumbnail) label.lastElementChild.before(await pictureOf(thumbnail, label.dataset.frame));
  }
}

const countsOf = ({ least, largest }) => `counts from ${numberText(least)} to ${numberText(largest)} DN`;

/** A small picture of a frame, brightened by the eye's curve, with its counts in words. */
async function pictureOf(thumbnail, name) {
  const { width, height, values } = thumbnail, counts = countsOf(thumbnail);
  const canvas = make("canvas", { width, height, role: "img", "aria-label": `${name}; ${counts}`, title: counts });
  const image = new ImageData(width, height);
  (await decoded(values)).forEach((value, i) => {
    const shade = 255 * value ** (1 / 2.2);
    image.data.set([shade, shade, shade, 255], 4 * i);
  });
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

const ticked = () => [...new Set([...document.querySelectorAll("#rows input[data-frames]:checked")]
  .flatMap((tick) => JSON.parse(tick.dataset.frames)))];

function countTicks() {
  const count = ticked().length;
  $("set-roles").textContent = `Set ${count} ticked ${count === 1 ? "frame" : "frames"}`;
  $("set-roles").disabled = count === 0;
}

$("rows").addEventListener("change", (event) => { if (event.target.dataset.frames) countTicks(); });

$("roles").addEventListener("submit", (event) => {
  event.preventDefault();
  const role = { kind: $("role-kind").value, filter: $("role-filter").value, exposure_s: $("role-exposure").value };
  attempt(() => send([], ticked().map((file) => ({ file, ...role }))));
});

const look = () => {
  page.folder = $("folder").value;
  page.shape = "";
  unsent.clear();
  $("form").hidden = true;
  return attempt(() => send());
};

$("which").addEventListener("submit", (event) => { event.preventDefault(); look(); });

$("next").addEventListener("click", () => {
  const next = inputs().find((input) => input.getAttribute("aria-invalid") === "true" || (input.getAttribute("aria-required") && !input.value));
  next?.focus();
});

$("write").addEventListener("click", () => attempt(async () => {
  const { form, folder } = page;
  const { path } = await ask("write", { entries: [...unsent.values()] });
  const name = encodeURIComponent(folder), has = (key) => form.text.includes(`\n${key} = `);
  const mark = make("a", { href: `points.html?capture=${name}` }, "mark corners in its photograph");
  const open = make("a", { href: `./?capture=${name}` }, "open it in the workbench");
  open.addEventListener("click", () => sessionStorage.setItem("open", folder));
  const next = !has("scene") ? ["Next: add a line such as scene = \"cornell-box\" at its top, then ", open, "."]
    : has("points") ? ["Next: ", open, "."] : ["Next: ", mark, ", then ", open, "."];
  $("form").hidden = true;
  $("saved").replaceChildren(`Written: ${path}. `, ...next);
  $("saved").querySelector("a").focus();
}));

const asked = new URLSearchParams(location.search).get("folder");
if (asked !== null) {
  $("folder").value = asked;
  look();
}
