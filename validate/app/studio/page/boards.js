/* The page that shows the boards found in a capture's frames, and drops views. Positions are px. */
"use strict";

/** Length of a drawn residual over the residual. */
const STRETCH = 100;

const page = {
  frames: [], // {frame, corners}, corners null where no board is found
  dropped: new Set(), // frames that are left out
  chosen: null, // frame
  fit: null, // {views, discordant, rms_px, focal_length_px, reason}
  point: 0, // index of the point whose residual is read out
  asking: 0, // number of the newest question; older answers are dropped
};

const ask = asker("boards");

const show = () => attempt(async () => {
  const { width, height, frames, notes } = await ask("views");
  Object.assign(page, { frames, width, height, chosen: frames[0].frame, point: 0 });
  page.dropped.clear();
  $("notes").replaceChildren(...notes.map((note) => make("li", {}, note)));
  $("work").hidden = false;
  await refit();
  await choose(page.chosen);
});

/** The lens of the ticked views. */
async function refit() {
  const number = ++page.asking;
  const fit = await ask("fit", { dropped: [...page.dropped] });
  if (number !== page.asking) return;
  page.fit = fit;
  const [focal, sigma] = fit.focal_length_px || [];
  $("fit").textContent = unbroken(fit.rms_px === null ? fit.reason
    : `Residuals: rms ${fit.rms_px.toFixed(3)} px per coordinate; focal length ${focal.toFixed(1)} ± ${sigma.toFixed(1)} px.`);
  list();
  photograph.draw();
}

async function choose(frame) {
  page.chosen = frame;
  page.point = 0;
  const { photograph: values } = await ask("frame", { frame });
  if (frame === page.chosen) photograph.show(page.width, page.height, await decoded(values));
}

/** State of a view in words. */
function words({ frame, corners }) {
  if (!corners) return "no board found";
  const points = `${corners.length} points`;
  if (page.dropped.has(frame)) return `${points}, left out`;
  if (page.fit.discordant[frame]) return `${points}, not used: ${page.fit.discordant[frame]}`;
  const view = page.fit.views[frame];
  return view ? `${points}, rms ${view.rms_px.toFixed(3)} px` : points;
}

function list() {
  $("views").replaceChildren(...page.frames.map((view, i) => {
    const tick = make("input", { type: "checkbox", "aria-label": `Use ${view.frame}` });
    tick.checked = !page.dropped.has(view.frame);
    tick.addEventListener("change", () => {
      page.dropped[tick.checked ? "delete" : "add"](view.frame);
      attempt(refit).then(() => $("views").children[i].querySelector("input").focus());
    });
    const see = make("button", { type: "button" }, "See");
    see.setAttribute("aria-label", `See ${view.frame}`);
    see.setAttribute("aria-pressed", view.frame === page.chosen);
    see.addEventListener("click", () => attempt(async () => {
      await choose(view.frame);
      list();
      $("views").children[i].querySelector("button").focus();
    }));
    return make("li", { class: "check" }, [tick, see, make("span", {}, `${view.frame}: ${words(view)}`)]);
  }));
  $("accept").disabled = page.dropped.size === 0;
}

const points = () => page.frames.find(({ frame }) => frame === page.chosen)?.corners || [];

function drawOver(context, at) {
  const residuals = page.fit && page.fit.views[page.chosen]?.residuals_px;
  points().forEach(([u, v], i) => {
    if (residuals) {
      const [du, dv] = residuals[i];
      stroked(context, "#56b4e9", (c) => { c.moveTo(...at(u, v)); c.lineTo(...at(u - STRETCH * du, v - STRETCH * dv)); }, 2);
    }
    cross(context, at(u, v), i === page.point ? "#fff" : "#e69f00", i === page.point ? 9 : 5);
  });
}

/** Say position and residual of a point. */
function read(index) {
  const all = points();
  if (!all.length) return;
  page.point = (index + all.length) % all.length;
  const [u, v] = all[page.point];
  const residual = page.fit && page.fit.views[page.chosen]?.residuals_px[page.point];
  const text = residual ? `; residual ${residual.map((x) => x.toFixed(3).replace("-", "−")).join(", ")} px` : "";
  $("saved").textContent = unbroken(`Point ${page.point + 1} of ${all.length} at ${u.toFixed(2)}, ${v.toFixed(2)} px${text}.`);
  photograph.draw();
}

const photograph = new Photograph($("picture"),
  "Frame of a board. Left and right arrow keys go from point to point and say its residual.", drawOver);
photograph.canvas.addEventListener("click", (event) => {
  const [u, v] = photograph.at(event);
  const distances = points().map((point) => Math.hypot(point[0] - u, point[1] - v));
  read(distances.indexOf(Math.min(...distances)));
});
photograph.canvas.addEventListener("keydown", (event) => {
  const step = arrowStep(event, 1, 1);
  if (!step) return;
  event.preventDefault();
  read(page.point + step[0] + step[1]);
});
$("which").addEventListener("submit", (event) => { event.preventDefault(); show(); });
$("accept").addEventListener("click", () => attempt(async () => {
  const names = [...page.dropped];
  if (!confirm(`capture.toml changes: ${names.join(", ")} will no longer be frames of the target. The files stay. Continue?`)) return;
  const { path } = await ask("write", { dropped: names });
  await show();
  $("saved").textContent = `Written: ${path}, without ${names.join(", ")}.`;
}));
attempt(async () => {
  const found = await (await fetch("api/places")).json();
  $("captures").replaceChildren(...found.captures.map((name) => make("option", { value: name })));
  const asked = new URLSearchParams(location.search).get("capture");
  $("capture").value = asked || found.captures[0] || "";
  if (asked) await show();
});
