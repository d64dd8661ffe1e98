/* The page that makes a capture.toml of a folder of frames: a field for each missing key, checked after each entry. */
"use strict";

const $ = (id) => document.getElementById(id);

const page = { entries: new Map(), offers: [], asking: 0, working: 0 };

async function ask(name) {
  const entries = [...page.entries.values()];
  const answer = await fetch("api/first/" + name, {
    method: "POST", headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ folder: $("folder").value, entries }),
  });
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

/** A field for a missing key; its entry is checked when it is left. */
function fieldOf({ where, key, example, why }, number) {
  const input = make("input", { id: `field-${number}`, placeholder: example, autocomplete: "off", "data-key": key, "data-where": where, "data-name": `${where} ${key}` });
  const name = `${where} ${key}`;
  input.value = page.entries.has(name) ? page.entries.get(name).value : "";
  input.addEventListener("change", () => {
    if (Number.isFinite(Number(example))) input.value = input.value.trim().replace(/^(-?\d+),(\d+)$/, "$1.$2");
    page.entries.set(name, { where, key, value: input.value });
    for (const offer of page.offers) offer();
    attempt(check);
  });
  const table = where.split(" ")[0];
  const alike = () => [...document.querySelectorAll(`input[data-key="${key}"]`)].filter((other) =>
    other !== input && !other.value && other.dataset.where.startsWith(table));
  const repeat = make("button", { type: "button", class: "small", hidden: "" });
  const offer = () => {
    const count = alike().length;
    repeat.hidden = !input.value || !count;
    repeat.textContent = `The same in ${count} empty ${count === 1 ? "field" : "fields"} of ${table}`;
  };
  page.offers.push(offer);
  repeat.addEventListener("click", () => {
    for (const other of alike()) {
      other.value = input.value;
      page.entries.set(other.dataset.name, { where: other.dataset.where, key, value: input.value });
    }
    for (const each of page.offers) each();
    attempt(check);
  });
  return make("div", { class: "field" }, [make("label", {}, [
    make("span", {}, [make("strong", {}, why[0].toUpperCase() + why.slice(1)), ` (${name}, such as ${example})`]), input]), repeat]);
}

/** Faults and text with the entries so far; an entry that is no value is marked. */
async function check() {
  const number = ++page.asking;
  let found;
  try {
    found = await ask("draft");
  } catch (error) {
    const [place] = error.message.split(": found");
    for (const input of document.querySelectorAll("input[data-key]"))
      if (place.endsWith(input.dataset.key) && page.entries.has(input.dataset.name)) input.setAttribute("aria-invalid", "true");
    throw error;
  }
  if (number !== page.asking) return;
  $("wrong").textContent = found.faults.length ? `Still wrong: ${found.faults.length}` : "Nothing is wrong";
  $("faults").replaceChildren(...found.faults.map((text) => make("li", {}, text)));
  $("text").textContent = found.text;
  for (const input of document.querySelectorAll("input[data-key]"))
    input.setAttribute("aria-invalid", String(Boolean(input.value) && found.faults.some((text) => text.split(":")[0].includes(input.dataset.key))));
  return found;
}

const look = () => attempt(async () => {
  page.entries.clear();
  page.offers = [];
  const found = await check();
  if (!found) return;  // the folder has been looked at again since
  const fields = (list) => list.map((key) => fieldOf(key, found.missing.indexOf(key)));
  $("required").replaceChildren(...fields(found.missing.filter((key) => key.key && key.required)));
  $("optional").replaceChildren(...fields(found.missing.filter((key) => key.key && !key.required)));
  $("notes").replaceChildren(...found.missing.filter((key) => !key.key).map((key) => make("li", {}, `${key.where}: ${key.why}`)));
  $("recognised").replaceChildren(...found.recognised.map(({ kind, name, frames }) =>
    make("li", {}, make("span", {}, `${[kind, name].filter(Boolean).join(" ")}: ${frames.length} × ${frames.slice(0, 3).join(", ")}${frames.length > 3 ? ", …" : ""}`))));
  $("left-out").replaceChildren(...(found.left_out.length ? found.left_out.map(({ file, why }) => `${file}: ${why}`) : ["nothing"])
    .map((text) => make("li", {}, text)));
  $("work").hidden = false;
  const { thumbnails } = await ask("thumbnails");
  for (const [i, item] of [...$("recognised").children].entries())
    if (thumbnails[i]) item.prepend(await pictureOf(thumbnails[i], item.textContent));
});

/** A small picture of a frame, brightened by the eye's curve, with its counts in words. */
async function pictureOf({ width, height, values, least, largest }, text) {
  const counts = `counts from ${numberText(least)} to ${numberText(largest)} DN`;
  const canvas = make("canvas", { width, height, role: "img", "aria-label": `First frame of ${text}; ${counts}`, title: counts });
  const image = new ImageData(width, height);
  (await decoded(values)).forEach((value, i) => {
    const shade = 255 * value ** (1 / 2.2);
    image.data.set([shade, shade, shade, 255], 4 * i);
  });
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

$("which").addEventListener("submit", (event) => { event.preventDefault(); look(); });
$("write").addEventListener("click", () => attempt(async () => {
  const { path } = await ask("write");
  const folder = encodeURIComponent($("folder").value);
  $("saved").replaceChildren(`Written: ${path}. Next: `,
    make("a", { href: `points.html?capture=${folder}` }, "mark corners in its photograph"), ", or ",
    make("a", { href: `./?capture=${folder}` }, "open it in the workbench"), ".");
}));
const asked = new URLSearchParams(location.search).get("folder");
if (asked !== null) {
  $("folder").value = asked;
  look();
}
