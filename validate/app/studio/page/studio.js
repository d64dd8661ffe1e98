/* The workbench's page: requests each step from the server, shows the answer. */
"use strict";

const $ = (id) => document.getElementById(id);

const page = {
  viewer: null, // the CBoxViewer, or null before a capture is open
  shape: null, // width and height of the picture, as text
  record: null, // the study as last received
  controls: [], // one per effect
  catalogue: [],
  pending: [], // moves that wait for the answer to the previous one
  asking: false,
  shownRevision: 0, // number of the state that the page shows
  revision: 0, // number of the study's state; a step names the one that it was made on
  tab: Math.random().toString(36).slice(2), // name of this tab in the events of its steps
  requests: 0, // number of answers that the page waits for
  loading: 0, // number of changed states that the page loads
  earlier: null, // pictures before a change, while they are shown or can be shown again: {first, chi2, rendered, sigma}
  shown: null, // the present pictures: {rendered, sigma}
  opened: {}, // chi-square of each capture when it was opened; empty in a page that is loaded later
};

/** Title of a page without a study. */
const BEGIN = "Open a capture to begin";

/** What the page says when the server has ended. */
const NO_ANSWER = "The program does not answer. Start `cbox studio` again. Unsaved work is offered there under Open.";

async function request(path, body) {
  const options = body === undefined ? {} : {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  };
  let answer;
  busy(1);
  try {
    answer = await fetch("api/" + path, options);
  } catch {
    throw new Error(NO_ANSWER);
  } finally {
    busy(-1);
  }
  if (!answer.ok) {
    const text = await answer.text();
    let message = text;
    try { message = JSON.parse(text).error; } catch { /* plain text */ }
    throw Object.assign(new Error(message), { status: answer.status });
  }
  const revision = answer.headers.get("CBox-Revision");
  if (revision !== null) page.revision = Number(revision);
  return answer;
}

/** Show that the page waits for an answer. */
function busy(change) {
  page.requests += change;
  document.body.dataset.busy = String(page.requests > 0);
}

/** The state that a step is made on, and the tab that makes it. */
const made = () => ({ revision: page.revision, tab: page.tab });

/** Run a step of the user; show an error in one line. */
async function attempt(step) {
  $("mistake").textContent = "";
  $("saved").textContent = "";
  try {
    await step();
  } catch (error) {
    $("mistake").textContent = error.message;
    if (error.status === 409) await receive(await request("view")).catch(() => null);
    else if (page.record) showEffects(page.record, true);
  }
}

/** A record and the arrays behind it, see wire.py. */
function parsed(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const record = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const numbers = new Float32Array(buffer, 4 + length);
  const half = numbers.length / 2;
  return { record, numbers, rendered: numbers.subarray(0, half), sigma: numbers.subarray(half) };
}

async function receive(answer) {
  const { record, rendered, sigma } = parsed(await answer.arrayBuffer());
  show(record);
  [page.shown, page.earlier] = [{ rendered, sigma }, null];
  showFlip(null);
  if (page.viewer && rendered.length) await page.viewer.update({ rendered, sigma });
  showGlance();
  showParts();
}

/** The difference in small, above the sliders of a narrow window. */
function showGlance() {
  const open = page.viewer && page.record.open;
  $("glance").hidden = !open;
  if (!open) return;
  const source = page.viewer.layer("residual");
  [$("mini").width, $("mini").height] = [source.width, source.height];
  $("mini").getContext("2d").drawImage(source, 0, 0);
  const pattern = page.viewer.picture.maps.find((map) => map.id.startsWith(PATTERN));
  for (const id of ["mini-pattern", "glance-pattern"]) $(id).hidden = !pattern;
  if (pattern) {
    const drawn = page.viewer.layer(page.viewer.state.b.startsWith(PATTERN) ? page.viewer.state.b : pattern.id);
    [$("mini-pattern").width, $("mini-pattern").height] = [drawn.width, drawn.height];
    $("mini-pattern").getContext("2d").drawImage(drawn, 0, 0);
  }
  $("glance-chi2").textContent = $("chi2").textContent;
}

/** Mean square of the difference over sigma, by band and by surface; noise alone gives about 1. */
function showParts() {
  if (!$("parts").open || !page.viewer || !page.record.open) return;
  const { measured, rendered, sigma, mask, surface, surfaces, bands, width, height } = page.viewer.picture;
  const size = width * height, byBand = bands.map(() => [0, 0]), bySurface = surfaces.map(() => [0, 0]);
  for (let i = 0; i < measured.length; i++) {
    const square = ((measured[i] - rendered[i]) / sigma[i]) ** 2;
    if (mask[i] || !Number.isFinite(square)) continue;
    const on = bySurface[surface[i % size]];
    for (const sums of [byBand[Math.floor(i / size)], on]) if (sums) [sums[0], sums[1]] = [sums[0] + square, sums[1] + 1];
  }
  const table = (kind, names, sums) => make("table", {}, [
    make("thead", {}, make("tr", {}, [make("th", { scope: "col" }, kind), make("th", { scope: "col" }, "χ² per sample")])),
    make("tbody", {}, names.map((name, i) => make("tr", {}, [make("th", { scope: "row" }, name),
      make("td", {}, sums[i][1] ? (sums[i][0] / sums[i][1]).toFixed(2) : "–")])))]);
  $("parts-tables").replaceChildren(
    table("Band", page.viewer.bandNames, byBand), table("Surface", surfaces, bySurface));
}

/** Words and button of a flip to earlier pictures; null for the present ones. */
function showFlip(earlier) {
  $("before").setAttribute("aria-pressed", String(Boolean(earlier)));
  $("before").textContent = earlier ? "Now" : "Before";
  $("earlier").textContent = earlier
    ? `Shown: before ${earlier.first ? "all changes" : "the last change"}, χ² ${numberText(+earlier.chi2.toPrecision(4))}. Sliders and figures are the present ones.` : "";
}

/** Flip between the present pictures and those before a change; the study stays. */
async function flip() {
  if ($("before").getAttribute("aria-pressed") === "true") {
    showFlip(null);
    return page.viewer.update(page.shown);
  }
  const first = $("before-what").value === "first";
  if (!page.earlier || page.earlier.first !== first) {
    const { record, rendered, sigma } = parsed(await (await request("earlier", { first })).arrayBuffer());
    page.earlier = { first, chi2: record.chi2_per_dof, rendered, sigma };
  }
  showFlip(page.earlier);
  await page.viewer.update({ rendered: page.earlier.rendered, sigma: page.earlier.sigma });
}

const PATTERN = "pattern-";

/** Show what an effect that is not added would change, between photograph and difference. */
async function showPattern() {
  if ($("pattern").getAttribute("aria-pressed") === "true") return hidePattern();
  const effect = $("new-effect").value;
  const { record, numbers } = parsed(await (await request("pattern", { effect })).arrayBuffer());
  const size = numbers.length / record.numbers.length;
  const value = ({ value: number, unit }) => `${typeof number === "number" ? printed(+number.toPrecision(3)) : number} ${unit}`.trim();
  const maps = record.numbers.map((each, i) => ({
    id: PATTERN + each.name, name: `${effect}, ${each.label} ${value(each)}`, unit: "σ", perBand: true,
    values: numbers.slice(i * size, (i + 1) * size),
  }));
  await page.viewer.update({ maps });
  page.viewer.set({ mode: "side", b: maps[0].id });
  $("pattern").setAttribute("aria-pressed", "true");
  $("pattern").textContent = "Hide its pattern";
  const more = maps.length > 1 ? ` ${maps.length} numbers: choose another pattern in the list B.` : "";
  const faint = maps.every((map) => map.values.every((v) => !(Math.abs(v) > 0.5))) ? " It changes nothing by half a standard deviation." : "";
  const isCamera = page.catalogue.some((each) => each.id === effect && each.stage.startsWith("camera"));
  const fitted = isCamera && page.record.refit ? " Camera and lamp are fitted and take up most of it: untick that below to see it bare." : "";
  $("pattern-words").textContent = `Picture B: change of the rendering by ${maps[0].name}, in standard deviations of the ` +
    `difference. Compare it with the difference, picture C.${more}${faint}${fitted}`;
  document.body.dataset.pattern = "true";
  showGlance();
}

async function hidePattern() {
  if ($("pattern").getAttribute("aria-pressed") === "false") return;
  $("pattern").setAttribute("aria-pressed", "false");
  $("pattern").textContent = "Show its pattern";
  $("pattern-words").textContent = "";
  delete document.body.dataset.pattern;
  if (!page.viewer) return;
  page.viewer.set(withoutPattern(page.viewer.state));
  await page.viewer.update({ maps: [] });
  showGlance();
}

/** The state of a viewer that has no pattern. */
const withoutPattern = (state) => Object.fromEntries(Object.entries({ a: "measured", b: "rendered", c: "residual" })
  .map(([key, instead]) => [key, state[key].startsWith(PATTERN) ? instead : state[key]]));

async function step(name, body = {}) {
  await receive(await request("step/" + name, { ...body, ...made() }));
}

function show(record) {
  const same = page.record && record.open && page.record.open &&
    JSON.stringify(page.record.effects.map((e) => e.id)) === JSON.stringify(record.effects.map((e) => e.id));
  page.record = record;
  page.revision = page.shownRevision = record.revision;
  document.body.dataset.open = record.open;
  if (!record.open) {
    $("title").textContent = BEGIN;
    $("figures").textContent = "";
    openPanel("open", true);
    enable(false);
    return void attempt(async () => {
      await fillInputs();
      $("open-capture").value ||= new URLSearchParams(location.search).get("capture") || "";
    });
  }
  $("title").textContent = `${record.captures[record.capture]} against ${record.model}`;
  const how = record.rendered ? "rendered" : record.improvable ? "predicted, to be rendered" : "predicted";
  const all = record.captures.length > 1 ? ` (all: ${record.chi2_of_captures.map((v) => numberText(v)).join(", ")})` : "";
  const chi2 = numberText(+record.chi2_per_dof.toPrecision(4));
  if (!record.can_undo) page.opened = { ...page.opened, [record.capture]: chi2 };
  const opened = record.can_undo && page.opened[record.capture] ? `; ${page.opened[record.capture]} when opened` : "";
  $("save-root").textContent = `below ${record.root}`;
  $("figures").replaceChildren(
    "χ² per degree of freedom ", make("strong", { id: "chi2" }, chi2), ` (noise alone: 1${opened})`,
    unbroken(`${all}, lamp × ${record.lamp_scale.toFixed(4)}, camera moved ${numberText(+record.camera_moved_px.toPrecision(2))} px; `),
    make("span", { id: "how" }, how), record.saved ? "" : " · not saved");
  $("moves").replaceChildren(...curve(record.moves));
  $("refit").checked = record.refit;
  $("capture-choice").hidden = record.captures.length < 2;
  $("capture").replaceChildren(...record.captures.map((name, i) => make("option", { value: i }, name)));
  $("capture").value = record.capture;
  showEffects(record, !same);
  record.effects.forEach((effect, i) =>
    page.controls[i].showProfile(record.profile && record.profile.which === i ? record.profile : null, effect));
  showCorrelations(record.correlations);
  showDiagnosis(record.diagnosis);
  enable(!page.job);
}

function showEffects(record, rebuild) {
  $("no-effects").hidden = record.effects.length > 0;
  if (!rebuild) {
    if (page.pending.length) return; // the user has newer values
    record.effects.forEach((effect, i) => page.controls[i].show(effect));
    return;
  }
  page.controls = record.effects.map((effect, index) => effectControls(effect, index, {
    moved: (name, value, commit) => move({ which: index, values: { [name]: value }, commit }),
    begun: () => request("cancel", { background: true }).catch(() => null),
    fit: () => attempt(() => request("job/fit", { which: [index], ...made() })),
    profile: (parameter) => attempt(() => request("job/profile", { effect: index, parameter, ...made() })),
    remove: () => attempt(() => step("remove", { which: index })),
  }));
  $("effects").replaceChildren(...page.controls.map((one) => one.element));
  if (page.job) enable(false);
}

/** Request a move; until the answer comes, only the newest move of each number waits. */
async function move(body) {
  const key = (one) => `${one.which} ${Object.keys(one.values)}`;
  page.pending = [...page.pending.filter((one) => key(one) !== key(body)), body];
  if (page.asking) return;
  page.asking = true;
  while (page.pending.length) {
    const next = page.pending.shift();
    await attempt(async () => {
      const answer = await request("step/change", { ...next, ...made() });
      if (!page.pending.length) await receive(answer);
    });
  }
  page.asking = false;
}

/** A small table of the correlations of fitted numbers, with a sentence for each strong one. */
function showCorrelations(found) {
  $("correlations").hidden = !found;
  if (!found) return void $("correlations").replaceChildren();
  const cell = (value, i, j) => make("td", i !== j && value !== null && Math.abs(value) > 0.9 ? { class: "strong" } : {},
    value === null ? "–" : value.toFixed(2).replace("-", "−"));
  const head = make("tr", {}, [make("th", { scope: "col" }, "number"), ...found.names.map((_, i) => make("th", { scope: "col" }, String(i + 1)))]);
  const rows = found.values.map((row, i) => make("tr", {},
    [make("th", { scope: "row" }, `${i + 1} ${found.names[i]}`), ...row.map((value, j) => cell(value, i, j))]));
  $("correlations").replaceChildren(make("h3", {}, "Correlations"), make("table", {}, [head, ...rows]),
    ...found.sentences.map((text) => make("p", { class: "soft" }, text)));
}

function showDiagnosis(found) {
  $("diagnosis").hidden = !found;
  if (!found) return;
  const adopt = make("button", { id: "adopt" }, "Use these effects");
  adopt.addEventListener("click", () => attempt(() => step("adopt")));
  const ranking = found.ranking.map((entry) => {
    const isEffect = page.catalogue.some((effect) => effect.id === entry.id);
    const add = make("button", { "aria-label": "Add " + entry.id }, "Add");
    add.addEventListener("click", () => attempt(() => step("add", { effect: entry.id, values: entry.values })));
    const explains = entry.explained === null ? "" : `explains ${(100 * entry.explained).toFixed(1)} % of the excess, `;
    const percent = 100 * entry.probability, size = isEffect ? entry.text : "a cause that is in no list";
    const text = `${entry.id}: ${size}; ${explains}probability ${percent < 0.05 ? "below 0.1" : percent.toFixed(1)} % `;
    return make("li", {}, isEffect ? [text, add] : [text]);
  });
  const known = found.selected.some((id) => id !== "unknown");
  $("diagnosis").replaceChildren(make("h3", {}, "Diagnosis"),
    ...found.sentences.map((sentence) => make("p", {}, sentence)), ...(known ? [adopt] : []),
    make("p", { class: "soft" }, "Each effect fitted alone, the most probable first. Errors of the rendering count as noise here" +
      (found.adequate ? ". What all probabilities lack to 100 % is that of a model that lacks nothing:" : ":")), make("ol", {}, ranking));
}

/** While a computation runs, only Cancel is enabled; nothing until the page shows its result. */
function enable(on) {
  on = on && !page.loading;
  const within = "#side button, #side select, #side input, #tools button, #tools select, .panel button";
  for (const element of document.querySelectorAll(within)) element.disabled = !on;
  const record = page.record;
  for (const id of ["show-open", "open-it"]) $(id).disabled = Boolean(page.job);
  if (!on || !record || !record.open) return;
  $("undo").disabled = !record.can_undo;
  $("redo").disabled = !record.can_redo;
  for (const id of ["before", "before-what"]) $(id).disabled = !record.can_undo;
  $("render").disabled = record.rendered;
  for (const id of ["fit-all", "fit-chosen"]) $(id).disabled = record.effects.length === 0;
}

function showJob(job) {
  const foreground = job && !job.background;
  const before = page.job;
  page.job = foreground ? job : null;
  $("job").hidden = !job;
  if (job) {
    $("stage").textContent = `${job.background ? "in the background: " : ""}${job.job}${job.stage && job.stage !== job.job ? ": " + job.stage : ""}`;
    $("progress").value = job.done;
    $("times").textContent = unbroken(job.times);
    $("cancel").hidden = job.background;
  }
  if (!page.record?.open) $("title").textContent = job?.job === "open" ? "Opening …" : BEGIN;
  if (Boolean(before) !== Boolean(page.job)) enable(!page.job);
}

/** FLIP of the present rendering; null while pictures before a change are shown. */
async function currentFlip() {
  return page.earlier && page.viewer.picture.rendered === page.earlier.rendered ? null : (await (await request("flip")).json()).flip;
}

/** Load the study and the picture of the capture in view again. */
async function reload() {
  const state = await (await request("state")).json();
  showJob(state.job);
  if (state.error) $("mistake").textContent = state.error;
  if (!state.open) return state.job && !state.job.background ? undefined : show(state);
  page.catalogue = await (await request("effects")).json();
  showCatalogue();
  const picture = await (await request("picture")).json();
  const view = page.viewer ? page.viewer.state : { mode: "side", a: "measured", b: "rendered", c: "residual" };
  if (page.viewer) Object.assign(view, withoutPattern(view));
  await hidePattern();
  const fits = page.viewer && page.shape === `${picture.width} ${picture.height}`;
  if (!fits) Object.assign(view, { x: picture.width / 2, y: picture.height / 2, zoom: 1, pixel: null, region: null });
  if (!fits && page.viewer) history.replaceState(null, "", location.pathname); // a link to another picture
  page.shape = `${picture.width} ${picture.height}`;
  const place = make("div", { id: "viewer" });
  $("picture").replaceChildren(place);
  page.viewer = new CBoxViewer(place, picture, { ...view, link: true, flip: currentFlip });
  await page.viewer.ready;
  await receive(await request("view"));
}

/** The effects that contain the search text, grouped by where they act. */
function showCatalogue() {
  const text = $("search").value.trim().toLowerCase(), chosen = $("new-effect").value;
  const fitting = page.catalogue.filter((e) => `${e.id} ${e.stage} ${e.title} ${e.summary}`.toLowerCase().includes(text));
  const groups = [...new Set(fitting.map((e) => e.stage))].map((stage) => make("optgroup", { label: stage },
    fitting.filter((e) => e.stage === stage).map((e) => make("option", { value: e.id }, `${e.id}: ${e.title}`))));
  $("new-effect").replaceChildren(...groups);
  if (fitting.some((e) => e.id === chosen)) $("new-effect").value = chosen;
  showSummary();
}

/** Reduced chi-square over the changes of the study, logarithmic, as a drawing with its description. */
function curve(moves) {
  const values = moves.filter((value) => typeof value === "number" && value > 0);
  if (values.length < 2) return [];
  const logs = values.map(Math.log), low = Math.min(...logs, 0), span = Math.max(...logs, 0) - low || 1;
  const at = (value, i) => `${((i / (values.length - 1)) * 196 + 2).toFixed(1)},${(34 - (30 * (value - low)) / span).toFixed(1)}`;
  const text = `χ² over ${values.length} states: ${values.slice(-6).map((v) => numberText(+v.toPrecision(3))).join(", ")}`;
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  for (const [key, value] of Object.entries({ viewBox: "0 0 200 36", width: 200, height: 36, role: "img", "aria-label": text }))
    svg.setAttribute(key, value);
  svg.innerHTML = `<title>${text}</title><line x1="0" x2="200" y1="${(34 + (30 * low) / span).toFixed(1)}" y2="${(34 + (30 * low) / span).toFixed(1)}"/>` +
    `<polyline points="${logs.map(at).join(" ")}"/>`;
  return [svg, make("small", {}, "χ² after each change; dashed: noise alone")];
}

function showSummary() {
  const effect = page.catalogue.find((one) => one.id === $("new-effect").value);
  $("new-summary").textContent = effect ? effect.summary : "No effect has these letters.";
  $("new-confirm").textContent = effect ? `To confirm it: ${effect.confirm}` : "";
  if (!page.job) for (const id of ["add", "pattern"]) $(id).disabled = !effect;
}

function openPanel(id, on) {
  $(id).hidden = !on;
  $("show-" + id).setAttribute("aria-expanded", String(on));
}

async function fillInputs() {
  const found = await (await request("places")).json();
  const options = (names) => names.map((name) => make("option", { value: name }));
  $("captures").replaceChildren(...options([...found.captures, ...found.studies]));
  $("models").replaceChildren(...options(found.models));
  const button = (text, label, step) => {
    const made = make("button", { type: "button", "aria-label": label }, text);
    made.addEventListener("click", step);
    return made;
  };
  const unsaved = found.unsaved.filter(({ path }) => path !== page.record.unsaved); // the open study is no other one
  $("unsaved").hidden = unsaved.length === 0;
  $("unsaved-list").replaceChildren(...unsaved.map(({ path, name, changed }) => {
    const when = new Date(1000 * changed).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
    const text = `${name}, ${when}`;
    return make("li", {}, [text, button("Continue", `Continue ${text}`, () => job("open", { capture: path })),
      button("Discard", `Discard ${text}`, () => attempt(async () => { await request("discard", { study: path }); await fillInputs(); }))]);
  }));
  const near = [...found.captures.map((path) => [path, "capture"]), ...found.studies.map((path) => [path, "study"])];
  $("found").hidden = false;
  const nothing = `None below ${page.record.root}. Start cbox studio with --folder for another folder.`;
  $("found-list").replaceChildren(...(near.length ? [] : [make("li", {}, nothing)]), ...near.slice(0, LISTED).map(([path, kind]) => make("li", {}, [`${path}, ${kind}`,
    button("Open", `Open ${path}`, () => job("open", { capture: path, model: kind === "capture" ? $("open-model").value : "" }))])),
    ...(near.length > LISTED ? [make("li", {}, `and ${near.length - LISTED} more: type the name above`)] : []));
}

/** Captures and studies that Open lists as buttons; the fields above complete the names of all. */
const LISTED = 12;

const job = (name, body = {}) => attempt(async () => { await request("job/" + name, body); });

$("undo").addEventListener("click", () => attempt(() => step("undo")));
$("redo").addEventListener("click", () => attempt(() => step("redo")));
$("render").addEventListener("click", () => job("render"));
$("diagnose").addEventListener("click", () => job("diagnose"));
$("cancel").addEventListener("click", () => attempt(() => request("cancel", {})));
$("add").addEventListener("click", () => attempt(async () => {
  await hidePattern();
  await step("add", { effect: $("new-effect").value });
}));
$("parts").addEventListener("toggle", showParts);
$("pattern").addEventListener("click", () => attempt(showPattern));
$("before").addEventListener("click", () => attempt(flip));
$("before-what").addEventListener("change", () => attempt(async () => {
  if ($("before").getAttribute("aria-pressed") !== "true") return;
  await flip();
  await flip();
}));
$("fit-all").addEventListener("click", () => job("fit"));
$("fit-chosen").addEventListener("click", () => attempt(async () => {
  const which = page.controls.map((one, i) => (one.ticked() ? i : -1)).filter((i) => i >= 0);
  if (!which.length) throw new Error("Tick the effects that you want to fit.");
  await request("job/fit", { which, ...made() });
}));
$("new-effect").addEventListener("change", () => { showSummary(); attempt(hidePattern); });
$("search").addEventListener("input", showCatalogue);
const chosen = () => ({ capture: Number($("capture").value), refit: $("refit").checked });
$("refit").addEventListener("change", () => attempt(() => step("show", chosen())));
$("capture").addEventListener("change", () => attempt(async () => { await step("show", chosen()); await reload(); }));
for (const id of ["open", "save"])
  $("show-" + id).addEventListener("click", () => attempt(async () => {
    openPanel(id, $(id).hidden);
    if (id === "open" && !$(id).hidden) await fillInputs();
  }));
$("open").addEventListener("submit", (event) => {
  event.preventDefault();
  job("open", { capture: $("open-capture").value, model: $("open-model").value });
});
$("open-model-it").addEventListener("click", () => job("model", { model: $("open-model").value || "cornell-box" }));
$("save").addEventListener("submit", (event) => {
  event.preventDefault();
  job("save", { folder: $("save-folder").value, report: $("save-report").checked });
});
addEventListener("keydown", (event) => {
  const isTyped = event.target.matches("input:not([type=range]):not([type=checkbox]), select, textarea");
  if (event.key === "b" && !event.ctrlKey && !event.metaKey && !event.altKey && !isTyped) $("before").click();
  if (!(event.ctrlKey || event.metaKey) || event.target.matches("input[type=text], input:not([type])")) return;
  const button = { z: event.shiftKey ? "redo" : "undo", Z: "redo", y: "redo" }[event.key];
  if (!button) return;
  event.preventDefault();
  $(button).click();
});

/** Show the end of a computation that was stopped or failed; it may have rendered the picture before. */
async function ended({ error, background }) {
  const state = await (await request("state")).json();
  if (state.revision !== page.shownRevision && !state.job) await reload();
  if (error !== "cancelled") $("mistake").textContent = error;
  else if (!background && page.record.open) $("saved").textContent = "Cancelled. The effects are unchanged.";
}

/** Load a changed state; until it is shown no step is made on the one before. */
async function following(load) {
  page.loading += 1;
  enable(false);
  await attempt(load);
  page.loading -= 1;
  enable(!page.job);
}

/** Open the capture that another page of the workbench asks for; no page of another origin can. */
async function openAsked() {
  const capture = sessionStorage.getItem("open");
  sessionStorage.removeItem("open");
  if (capture !== null && !page.job) await job("open", { capture, model: "" });
}

const events = new EventSource("api/events");
events.onmessage = (message) => {
  const event = JSON.parse(message.data);
  if (event.event === "progress") return showJob(event);
  if (event.event === "moved") {
    if (event.tab !== page.tab && event.revision !== page.revision) following(reload);
    return;
  }
  if (event.event === "end") {
    showJob(null);
    if (!page.record) return void reload();
    if (event.error) ended(event);
    return;
  }
  if (event.event === "changed") {
    openPanel("open", false);
    following(async () => {
      await reload();
      if (event.saved.length) {
        openPanel("save", false);
        $("saved").textContent = "Saved: " + event.saved.join(", ");
      }
    });
  }
};
new ResizeObserver(([{ target }]) => document.body.style.setProperty("--head", `${target.offsetHeight}px`))
  .observe(document.querySelector("header"));
addEventListener("beforeunload", (event) => {
  if (page.record && page.record.open && !page.record.saved) event.preventDefault();
});
addEventListener("pageshow", (event) => { if (event.persisted) attempt(reload); }); // back and forward
events.onopen = async () => { // also after the server was away
  await attempt(reload);
  await openAsked();
};
events.onerror = () => {
  showJob(null);
  $("mistake").textContent = NO_ANSWER;
};
