/* One effect's controls: a slider, a number and its bounds for each parameter. It sends no requests. */
"use strict";

/** An element with attributes and children. */
function make(name, attributes = {}, children = []) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...[].concat(children).map(unbroken));
  return element;
}

/** A number as text, with at most six significant digits; infinity as "inf". */
function numberText(value) {
  return typeof value === "number" ? String(+value.toPrecision(6)) : value === null ? "" : value;
}

/** A number in a sentence, with the sign that tables have. */
const printed = (value) => String(numberText(value)).replace("-", "−");

/** Value and standard deviation, to two significant digits of the latter. */
function withError(value, sigma) {
  if (typeof value !== "number" || !(sigma > 0)) return numberText(value);
  const places = Math.min(Math.max(1 - Math.floor(Math.log10(sigma)), 0), 20);
  return `${value.toFixed(places)} ± ${sigma.toFixed(places)}`.replaceAll("-", "−");
}

/** The coordinate in which an effect grows evenly; "inf" has the coordinate 0 of an inverse square. */
function toCoordinate(parameter, value) {
  const number = value === "inf" ? Infinity : Number(value);
  return parameter.scale === "inverse square" ? 1 / number ** 2 : number;
}

function fromCoordinate(parameter, coordinate) {
  if (parameter.scale !== "inverse square") return coordinate;
  return coordinate <= 1e-12 ? "inf" : coordinate ** -0.5;
}

/**
 * A slider's position, -1000 to 1000, of a value. Positions are fine near the null value: the distance from it grows
 * with the cube of the slider's position. Without a null value they are even.
 */
function positionOf(parameter, value) {
  const [low, null_, high] = parameter.coordinate;
  const c = Math.min(Math.max(toCoordinate(parameter, value), low), high);
  if (null_ === null) return Math.round(1000 * ((2 * (c - low)) / (high - low) - 1));
  const span = c >= null_ ? high - null_ : null_ - low;
  return span === 0 ? 0 : Math.round(1000 * Math.sign(c - null_) * Math.cbrt(Math.abs(c - null_) / span));
}

function valueAt(parameter, position) {
  const [low, null_, high] = parameter.coordinate;
  const t = position / 1000;
  if (null_ === null) return fromCoordinate(parameter, low + ((t + 1) / 2) * (high - low));
  if (t === 0) return parameter.null;
  const value = fromCoordinate(parameter, null_ + (t > 0 ? high - null_ : null_ - low) * t ** 3);
  return typeof value === "number" ? +value.toPrecision(4) : value;
}

/** Least and largest position of a slider; one of them is 0 if the null value is a bound. */
function positions(parameter) {
  const [low, null_, high] = parameter.coordinate;
  return null_ === null ? [-1000, 1000] : [null_ > low ? -1000 : 0, high > null_ ? 1000 : 0];
}

/**
 * The controls of a parameter. moved(value, commit): called while the slider moves, and once when it stops.
 * begun(): called when the user presses the slider. profile(): asks for chi-square over the number.
 */
function parameterControls(parameter, id, moved, begun, profile) {
  if (parameter.choices.length) {
    const list = make("select", { id }, parameter.choices.map((name) => make("option", { value: name }, name)));
    list.addEventListener("change", () => moved(list.value, true));
    const label = make("label", { for: id }, parameter.label);
    return { element: make("div", { class: "parameter" }, [label, list]), show: (value) => { list.value = value; } };
  }
  const [least, most] = positions(parameter);
  const step = 10;
  const slider = make("input", { type: "range", id, min: least, max: most, step: "any" });
  const number = make("input", { type: "text", inputmode: "decimal", size: 8, "aria-label": parameter.label + ", number" });
  const label = make("label", { for: id }, parameter.label + (parameter.unit ? ", " + parameter.unit : ""));
  const bounds = make("div", { class: "bounds" });
  const curve = make("button", { class: "small", "aria-label": `χ² over this number: ${parameter.label}` }, "χ² over this number");
  curve.addEventListener("click", profile);
  const drawing = make("div", { class: "profile" });
  const known = [`${printed(parameter.low)} to ${printed(parameter.high)} ${parameter.unit}`.trim()];
  if (parameter.null !== null) known.push(`no effect at ${printed(parameter.null)}`);
  const at = (value, sigma) => {
    number.value = sigma === undefined ? numberText(value) : withError(value, sigma).split(" ")[0].replace("−", "-");
    slider.setAttribute("aria-valuetext", `${numberText(value)} ${parameter.unit}`.trim());
  };
  slider.addEventListener("pointerdown", begun);
  slider.addEventListener("input", () => {
    const value = valueAt(parameter, Number(slider.value));
    at(value);
    moved(value, false);
  });
  slider.addEventListener("change", () => moved(valueAt(parameter, Number(slider.value)), true));
  slider.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
    if (!way) return;
    event.preventDefault();
    slider.value = Math.min(most, Math.max(least, Math.round(Number(slider.value) / step) * step + way * step));
    slider.dispatchEvent(new Event("input"));
    slider.dispatchEvent(new Event("change"));
  });
  number.addEventListener("change", () => {
    const text = number.value.trim().replace(",", ".");
    moved(text === "inf" ? "inf" : text === "" || Number.isNaN(Number(text)) ? text : Number(text), true);
  });
  const show = (value, sigma) => {
    at(value, sigma);
    slider.value = positionOf(parameter, value);
    const fitted = sigma === undefined ? [] : [`fitted ${withError(value, sigma)}`];
    bounds.textContent = [...fitted, ...known].join("; ");
  };
  const showProfile = (found, value) => drawing.replaceChildren(...(found ? profileDrawing(parameter, found, value) : []));
  return { element: make("div", { class: "parameter" }, [label, slider, number, bounds, curve, drawing]), show, showProfile };
}

/** Size of the drawing of a profile, CSS px. */
const PROFILE = { width: 300, height: 96, margin: 4 };

/** Chi-square over a number, logarithmic, with a line at the present value and its main figures in words. */
function profileDrawing(parameter, found, present) {
  const { width, height, margin } = PROFILE;
  const logs = found.chi2_per_dof.map(Math.log), places = found.coordinates;
  const [low, high] = [Math.min(...logs, 0), Math.max(...logs)];
  const [first, last] = [Math.min(...places), Math.max(...places)];
  const x = (c) => margin + ((width - 2 * margin) * (c - first)) / (last - first || 1);
  const y = (log) => height - margin - ((height - 2 * margin) * (log - low)) / (high - low || 1);
  const short = (value) => (typeof value === "number" ? printed(+value.toPrecision(3)) : value);
  const unit = found.unit ? " " + found.unit : "";
  const at = (value) => short(found.chi2_per_dof[found.values.indexOf(value)]);
  const [start, end] = [found.values[0], found.values.at(-1)];
  const text = `χ² per degree of freedom from ${short(start)} to ${short(end)}${unit}: ${at(start)} and ${at(end)} at the ends; ` +
    `of these values the least, ${at(found.best)}, at ${short(found.best)}${unit}. Logarithmic; dashed: noise alone, 1; vertical: present value.`;
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  for (const [key, value] of Object.entries({ viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": text })) svg.setAttribute(key, value);
  const mark = Math.min(Math.max(x(toCoordinate(parameter, present)), 0), width).toFixed(1), one = y(0).toFixed(1);
  svg.innerHTML = `<line class="one" x1="0" x2="${width}" y1="${one}" y2="${one}"/><line x1="${mark}" x2="${mark}" y1="0" y2="${height}"/>` +
    `<polyline points="${places.map((c, i) => `${x(c).toFixed(1)},${y(logs[i]).toFixed(1)}`).join(" ")}"/>` +
    places.map((c, i) => `<circle cx="${x(c).toFixed(1)}" cy="${y(logs[i]).toFixed(1)}" r="2"/>`).join("");
  return [svg, make("p", { class: "soft" }, text)];
}

/** The controls of an applied effect. does: {moved(name, value, commit), begun(), fit(), remove(), profile(name)}. */
function effectControls(effect, index, does) {
  const tick = make("input", { type: "checkbox", "aria-label": `Tick ${effect.id}` });
  const head = make("h3", {}, [tick, make("span", {}, effect.id)]);
  const element = make("li", { "data-effect": effect.id }, [head, make("p", { class: "soft" }, effect.summary)]);
  const shows = {};
  for (const parameter of effect.parameters) {
    const controls = parameterControls(parameter, `p-${index}-${parameter.name}`,
      (value, commit) => does.moved(parameter.name, value, commit), does.begun, () => does.profile(parameter.name));
    shows[parameter.name] = controls;
    element.append(controls.element);
  }
  const fit = make("button", {}, "Fit");
  fit.addEventListener("click", does.fit);
  const remove = make("button", { "aria-label": `Remove ${effect.id}` }, "Remove");
  remove.addEventListener("click", does.remove);
  element.append(make("div", { class: "row" }, [fit, remove]));
  const show = (now) => {
    for (const [name, each] of Object.entries(shows)) each.show(now.values[name], now.sigma[name]);
  };
  const showProfile = (found, now) => {
    for (const [name, each] of Object.entries(shows))
      if (each.showProfile) each.showProfile(found && found.name === name ? found : null, now.values[name]);
  };
  show(effect);
  return { element, show, showProfile, ticked: () => tick.checked };
}
