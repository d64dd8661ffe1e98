/* The page on which corners of the scene are marked in the photograph. Positions are px; a pixel's centre is whole. */
"use strict";

const page = {
  picture: null, // width, height, corners
  marks: new Map(), // by id of a corner: {u, v, by_edges, error_px, residual_px}
  expected: {}, // by id: where the camera sees a corner
  chosen: null, // id
  asking: 0, // number of the newest question; older answers are dropped
};

const marks = () => [...page.marks].map(([id, { u, v }]) => ({ id, u, v }));
const ask = asker("points", () => ({ points: marks() }));

const show = () => attempt(async () => {
  page.marks.clear();
  page.expected = {};
  page.picture = await ask("picture", { points: [] });
  page.chosen = page.picture.corners[0].id;
  $("work").hidden = false;
  list();
  photograph.show(page.picture.width, page.picture.height, await decoded(page.picture.photograph));
});

/** A residual to 0.01 px with its sign, and zero without one. */
function signed(value) {
  const text = Math.abs(value).toFixed(2);
  return `${Number(text) === 0 ? "" : value < 0 ? "−" : "+"}${text}`;
}

/** Positions, residuals and the other corners, for the marks as they are. */
async function locate(by_edges) {
  const number = ++page.asking;
  const found = await ask("locate", { by_edges });
  if (number !== page.asking) return;
  for (const { id, ...mark } of found.points) page.marks.set(id, mark);
  page.expected = found.expected;
  const rms = found.rms_px === null ? "" : `Residuals of the camera: rms ${found.rms_px.toFixed(3)} px per coordinate. `;
  $("fit").textContent = unbroken(rms) + (found.reason && page.marks.size >= 6 ? found.reason : found.reason ? `${page.marks.size} of at least 6 corners.` : "");
  list();
  draw();
}

function mark(u, v) {
  [u, v] = photograph.inside([u, v]);
  page.marks.set(page.chosen, { u, v, by_edges: false, error_px: null, residual_px: [null, null], why: "" });
  draw();
  attempt(() => locate(false));
}

function list() {
  const rows = page.picture.corners.map((corner) => {
    const input = make("input", { type: "radio", name: "corner", value: corner.id });
    input.checked = corner.id === page.chosen;
    input.addEventListener("change", () => { page.chosen = corner.id; draw(); drawPlan(); });
    const at = page.marks.get(corner.id);
    const [du, dv] = at ? at.residual_px : [null, null];
    const residual = du === null ? "" : `; residual ${signed(du)}, ${signed(dv)}`;
    const how = at && at.by_edges ? ` by edges ± ${at.error_px.toFixed(2)}` : at && at.why ? ` as clicked (${at.why})` : "";
    const text = at ? `${at.u.toFixed(2)}, ${at.v.toFixed(2)} px${how}${residual}` : "not marked";
    return make("label", { class: "check" }, [input,
      make("span", {}, `${corner.name} (${corner.position_mm.map(numberText).join(", ")} mm): ${text}`)]);
  });
  $("corners").replaceChildren(...rows);
  drawPlan();
}

/** Outline of points in a plane: their convex hull, by Andrew's chain. */
function outline(points) {
  const sorted = [...points].sort(([a, b], [c, d]) => a - c || b - d);
  const half = (list) => list.reduce((chain, p) => {
    const turns = ([a, b], [c, d]) => (c - a) * (p[1] - b) - (d - b) * (p[0] - a) > 0;
    while (chain.length > 1 && !turns(chain.at(-2), chain.at(-1))) chain.pop();
    return [...chain, p];
  }, []).slice(0, -1);
  return [...half(sorted), ...half(sorted.reverse())];
}

/** The scene from the front and from above, with the chosen corner: the camera looks along +z, and x grows to the left. */
function drawPlan() {
  const corners = page.picture.corners, size = 130;
  const axes = [0, 1, 2].map((k) => corners.map((corner) => corner.position_mm[k]));
  const low = axes.map((values) => Math.min(...values)), most = Math.max(...axes.map((values, k) => Math.max(...values) - low[k])) || 1;
  const at = (corner, up, left) => [
    left + size * (1 - (corner.position_mm[0] - low[0]) / most), 20 + size * (1 - (corner.position_mm[up] - low[up]) / most)];
  const surfaces = new Map();
  for (const corner of corners)
    for (const name of corner.name.split(", ")) surfaces.set(name, [...(surfaces.get(name) || []), corner]);
  const chosen = corners.find((corner) => corner.id === page.chosen);
  const views = [["from the front", 1, 6], ["from above", 2, 176]].map(([title, up, left]) =>
    `<text x="${left}" y="13">${title}</text>` +
    [...surfaces.values()].map((of) => `<polygon points="${outline(of.map((corner) => at(corner, up, left))).join(" ")}"/>`).join("") +
    `<circle cx="${at(chosen, up, left)[0]}" cy="${at(chosen, up, left)[1]}" r="5"/>`);
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const label = `The chosen corner at x ${chosen.position_mm[0]}, y ${chosen.position_mm[1]}, z ${chosen.position_mm[2]} mm: x to the left, y up, z away from the camera`;
  for (const [key, value] of Object.entries({ viewBox: "0 0 330 158", role: "img", "aria-label": label })) svg.setAttribute(key, value);
  svg.innerHTML = views.join("");
  $("plan").replaceChildren(svg, make("figcaption", { class: "soft" }, `${label}.`));
}

function drawOver(context, at) {
  for (const [id, [u, v]] of Object.entries(page.expected)) {
    if (page.marks.has(id)) continue;
    cross(context, at(u, v), "#56b4e9", 3);
    if (id === page.chosen) stroked(context, "#56b4e9", (c) => c.arc(...at(u, v), 10, 0, 2 * Math.PI), 2);
  }
  for (const [id, { u, v }] of page.marks) cross(context, at(u, v), id === page.chosen ? "#fff" : "#e69f00", 8);
}

const photograph = new Photograph($("picture"),
  "Photograph. Arrow keys move the chosen corner by 0.5 px, with Shift by 0.1 px.", drawOver);
const draw = () => photograph.draw();

photograph.canvas.addEventListener("click", (event) => mark(...photograph.at(event)));
photograph.canvas.addEventListener("keydown", (event) => {
  const step = arrowStep(event, 0.5, 0.1);
  if (!step) return;
  event.preventDefault();
  const [u, v] = page.expected[page.chosen] || [(photograph.width - 1) / 2, (photograph.height - 1) / 2];
  const from = page.marks.get(page.chosen) || { u, v };
  mark(from.u + step[0], from.v + step[1]);
});
$("which").addEventListener("submit", (event) => { event.preventDefault(); show(); });
$("refine").addEventListener("click", () => attempt(() => locate(true)));
$("remove").addEventListener("click", () => {
  page.marks.delete(page.chosen);
  if (page.marks.size) attempt(() => locate(false));
  list();
  draw();
});
$("write").addEventListener("click", () => attempt(async () => {
  const { path, lines, added } = await ask("write");
  const text = lines.replace("\n", " ");
  $("saved").replaceChildren(`Written: ${path}. ${added ? `Added to capture.toml: ${text}` : `capture.toml needs: ${text}`}. Next: `,
    make("a", { href: `./?capture=${encodeURIComponent($("capture").value)}` }, "open it in the workbench"), ".");
}));
attempt(async () => {
  const found = await (await fetch("api/places")).json();
  $("captures").replaceChildren(...found.captures.map((name) => make("option", { value: name })));
  const asked = new URLSearchParams(location.search).get("capture");
  $("capture").value = asked || found.captures[0] || "";
  if (asked) await show();
});
