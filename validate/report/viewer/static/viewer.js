/*
 * CBoxViewer: a measured picture and its render, band by band, down to single pixels.
 *
 *   const viewer = new CBoxViewer(element, data, options);
 *   await viewer.ready;                  // arrays are unpacked, the first picture is drawn
 *   await viewer.update({rendered, sigma});   // new predictions, drawn at once; also measured, mask, light, spectrum, maps
 *   viewer.set({mode: "side", band: 2}); // change what is shown, see `state`
 *   viewer.select(x, y);                 // what a click does; viewer.select(null) closes the panel
 *   viewer.values(x, y);                 // all data of a pixel, as plain numbers
 *   viewer.csv("panes" | "region");      // what is shown as the text of a CSV file
 *   viewer.bandNames;                    // names of the bands as tables print them
 *   viewer.layer("residual");            // canvas of a layer as it is painted now
 *   viewer.figure(n);                    // canvas of the n-th picture with caption and scales
 *   viewer.state;                        // a copy: mode "slider" | "flip" | "side", layers a, b (compared) and c (beside
 *                                        // them), band, exposure, scale "standard" | "fine" | "coarse" | "own",
 *                                        // zoom, x, y (centre, px), split (%), showing "a" | "b", pixel [x, y] or null,
 *                                        // tool "pixel" | "rectangle" | "polygon" | "line", region {kind, points} or null
 *
 * Events on `element`, both bubble:
 *   "cbox-pixel"  detail: viewer.values(x, y), or null where the panel was closed
 *   "cbox-view"   detail: viewer.state after a change by the user or by set()
 *
 * options: the state to begin with, e.g. {mode: "slider", a: "measured", b: "rendered", c: "residual"}; and link: true
 * for a page whose address holds the view in its fragment; and flip: async function that gives FLIP of the rendering shown,
 * encoded, or null. It is called when FLIP is shown after an update without it.
 * Layers: measured, rendered, residual (in sigma), absolute, relative, luminance, masks, and the ids in data.colour_differences and data.maps.
 * band: number of a band; -1 all bands (pictures as sRGB); -2, -3, -4 for X, Y, Z.
 *
 * data (validate/report/viewer/payload.py makes it; bands stand in the order of their wavelengths):
 *   width, height       px; block   side of the blocks of the capture's pixels that one of these is the mean of
 *   bands               [{id, nm}], nm null where not known
 *   measured, rendered, sigma   (band, y, x) DN      mask   (band, y, x) sum of the bits of `reasons`
 *   reasons             [{bit, name}]
 *   surface             (y, x) index into `surfaces`, -1 the lamp, -2 outside the box; surfaces  [name]
 *   xyz_per_dn          3 rows of one number per band; xyz_unit   its unit; white  {x, y, luminance}
 *   srgb                3 x 3, XYZ over the white's luminance to linear sRGB, adapted to the white
 *   colour_differences  [{id, label, title, unit, script}], script a name in COLOUR_DIFFERENCES of colour.js
 *   flip                null or (y, x) FLIP, 0 to 1; flip_lacking  what is said where it is null
 *   colours             {diverging, sequential}: hexadecimal stops
 *   light               null or {names, share: (k, y, x)}
 *   spectrum            null or {wavelength_nm, basis: (k, w), coefficients: (k, y, x), rank, unit}
 *   filters             null or {wavelength_nm, curves: (band, w), largest 1}
 *   maps                [{id, name, unit, perBand, values: (band, y, x) or (y, x), red}] further layers, in sigma; red: meaning of values above 0
 * An array is a typed array, a list, or encoded: see arrays.js.
 */
class CBoxViewer {
  constructor(element, data, options = {}) {
    this.element = element;
    this._state = {
      mode: "slider", a: "measured", b: "rendered", c: "residual", band: -1, exposure: 0, scale: "standard",
      zoom: 1, x: data.width / 2, y: data.height / 2, split: 50, showing: "a", pixel: null, tool: "pixel", region: null,
    };
    const { link, flip, ...first } = options;
    this._askFlip = data.flip ? flip : undefined;
    this._link = Boolean(link);
    Object.assign(this._state, first);
    this._painted = new Map();
    element.classList.add("cbox-viewer");
    this.ready = this._open(data).catch((error) => {
      element.replaceChildren(html("p", { role: "alert" }, "This picture cannot be shown: " + error.message));
      throw error;
    });
  }

  get state() {
    return structuredClone(this._state);
  }

  async _open(data) {
    const tables = { diverging: colourTable(data.colours.diverging), sequential: colourTable(data.colours.sequential) };
    this.picture = { ...data, tables, flip_later: Boolean(this._askFlip) };
    await this._take(data);
    if (this._link) Object.assign(this._state, linkedState(location.hash, this.picture));
    this._clamp();
    this._build();
    new ResizeObserver(() => this._draw()).observe(this.element);
    this._refresh();
  }

  async _take(data) {
    const picture = this.picture;
    if (this._controls && data.rendered && !data.flip) {
      [picture.flip, picture.flip_lacking] = [null, "FLIP: of another rendering; see its report"];
      this._flipAsked = false;
    }
    for (const name of ["measured", "rendered", "sigma", "mask", "surface", "flip"])
      if (data[name]) picture[name] = await decoded(data[name]);
    if (data.light) picture.light = { ...data.light, share: await decoded(data.light.share) };
    if (data.filters) picture.filters = { ...data.filters, curves: await decoded(data.filters.curves) };
    if (data.spectrum)
      picture.spectrum = {
        ...data.spectrum, basis: await decoded(data.spectrum.basis),
        coefficients: await decoded(data.spectrum.coefficients),
      };
    if (data.maps)
      picture.maps = await Promise.all(
        data.maps.map(async (map) => ({ ...map, values: await decoded(map.values) })));
  }

  /** Replace arrays; what is shown and where stays. Resolves when the new picture is drawn. */
  async update(data) {
    await this.ready;
    await this._take(data);
    for (const key of [...this._painted.keys()])
      if (!key.startsWith("measured ") || data.measured) this._painted.delete(key);
    if (data.maps || data.rendered) this._fillLists();
    this._refresh();
  }

  /** Change the state: any of its keys. */
  set(changes) {
    Object.assign(this._state, changes);
    this._clamp();
    this._refresh();
    if (this._link) this._writeLink();
    this.element.dispatchEvent(new CustomEvent("cbox-view", { detail: this.state, bubbles: true }));
  }

  /** Put the view into the page's address, once nothing has moved for a while: browsers limit how often. */
  _writeLink() {
    clearTimeout(this._writing);
    this._writing = setTimeout(() => {
      if (this.element.isConnected) history.replaceState(history.state, "", linkOf(this._state));
    }, 200);
  }

  /** The pictures shown, or the region, as the text of a CSV file. */
  csv(what) {
    const { region, band } = this._state;
    if (what === "region") return csvText(regionRows(this.picture, region, band));
    const ids = [...new Set(this._panes().flat())];
    return csvText(pixelRows(this.picture, ids.map((id) => {
      const { values, scale } = this._paintedLayer(id);
      const unit = values ? scale?.unit : this.picture.xyz_unit;
      const name = values ? this._caption(id) : `${this._layer(id).name}, Y`;
      return { name: unit && !name.endsWith(unit) ? `${name} (${unit})` : name, values: values ?? layerValues(this.picture, this._layer(id), -1) };
    })));
  }

  /** Names of the bands as tables print them. */
  get bandNames() {
    return bandNames(this.picture.bands);
  }

  /** Canvas of a layer as it is painted now, one of its pixels for each of the picture's. */
  layer(id) {
    return this._paintedLayer(id).canvas;
  }

  /** Canvas of the n-th picture as it is shown, with caption and scales. */
  figure(n) {
    const ids = this._panes()[n];
    const bars = ids.map((id) => ({ scale: this._paintedLayer(id).scale, text: this._scaleText(id) })).filter((bar) => bar.scale);
    const canvas = this._figures.children[n].querySelector("canvas");
    return figureCanvas(canvas, ids.map((id) => this._caption(id)).join(" | "), bars);
  }

  _savePictures() {
    this._panes().forEach((ids, n) => this.figure(n).toBlob((blob) => download(`${ids.join("-")}.png`, blob)));
  }

  _saveTable(what) {
    download(what === "region" ? `${this._state.region.kind}.csv` : "pixels.csv", new Blob([this.csv(what)], { type: "text/csv" }));
  }

  /** Add a point to the region of the tool; both points of a rectangle or line may be given. */
  mark(point, from = null) {
    const { tool, region } = this._state;
    this.set({ region: from ? { kind: tool, points: [from, point] } : withPoint(region, tool, point) });
  }

  values(x, y) {
    return pixelRecord(this.picture, x, y);
  }

  /** Show the panel of a pixel; `null` closes it. */
  select(x, y) {
    const pixel = x === null ? null : [x, y];
    this.set({ pixel });
    const record = pixel && this.values(x, y);
    this._status.textContent = record ? this._words(record) : "";
    this.element.dispatchEvent(new CustomEvent("cbox-pixel", { detail: record, bubbles: true }));
  }

  _words(record) {
    const bands = record.bands.map((band) =>
      `${band.nm === null ? band.id : band.nm.toFixed(0) + " nm"}: ` +
      (band.reasons.length ? "left out, " + band.reasons.join(", ") : signed(band.residual, 1) + " σ"));
    return `Pixel ${record.x}, ${record.y}, ${record.surface}. Difference ${bands.join("; ")}.`;
  }

  _layer(id) {
    const found = layersOf(this.picture).find((layer) => layer.id === id);
    if (!found) throw new Error("viewer: no layer '" + id + "'");
    return found;
  }

  _paintedLayer(id) {
    const { band, exposure, scale } = this._state;
    const key = [id, band, exposure, scale].join(" ");
    if (!this._painted.has(key)) {
      const result = painted(this.picture, this._layer(id), this._state);
      const canvas = html("canvas", { width: this.picture.width, height: this.picture.height });
      canvas.getContext("2d").putImageData(new ImageData(result.rgba, this.picture.width), 0, 0);
      if (this._painted.size > 60) this._painted.clear();
      this._painted.set(key, { ...result, canvas });
    }
    return this._painted.get(key);
  }

  /** Layers that the panes show, left to right; in the slider's pane both. */
  _panes() {
    const { mode, a, b, c, showing } = this._state;
    if (mode === "side") return [[a], [b], [c]];
    return [mode === "flip" ? [showing === "a" ? a : b] : [a, b], [c]];
  }

  _clamp() {
    const s = this._state;
    const { width, height } = this.picture;
    s.zoom = Math.min(Math.max(s.zoom, 1), Math.max(width, height) / 4);
    const inside = (v, size) => Math.min(Math.max(v, size / 2 / s.zoom), size - size / 2 / s.zoom);
    [s.x, s.y] = [inside(s.x, width), inside(s.y, height)];
    s.split = Math.min(Math.max(s.split, 0), 100);
  }

  // ---- page

  _build() {
    const choice = (name, label, entries) => {
      const select = html("select", { "data-cbv": name },
        entries.map(([value, text]) => html("option", { value }, text)));
      select.addEventListener("change", () => {
        const value = select.value;
        this.set({ [name]: name === "band" ? Number(value) : value });
      });
      return html("label", { "data-of": name }, [html("span", {}, label), select]);
    };
    const button = (name, text, act) => {
      const element = html("button", { type: "button", "data-cbv": name }, text);
      element.addEventListener("click", act);
      return element;
    };
    const range = (name, label, low, high, step) => {
      const input = html("input", { type: "range", min: low, max: high, step, "data-cbv": name });
      input.addEventListener("input", () => this.set({ [name]: Number(input.value) }));
      return html("label", { "data-of": name }, [html("span", {}, label), input, html("output", {})]);
    };
    const bands = this.picture.bands.map((band, b) => [b, band.nm === null ? band.id : `${band.nm.toFixed(0)} nm (${band.id})`]);
    this._controls = html("div", { class: "cbv-controls" }, [
      choice("mode", "View", [["slider", "slider A | B, and C"], ["flip", "flip A / B, and C"], ["side", "A, B, C side by side"]]),
      choice("a", "A", []), choice("b", "B", []), choice("c", "C", []),
      choice("band", "Show", [[-1, "all bands (sRGB)"], ...bands, [-2, "X"], [-3, "Y"], [-4, "Z"]]),
      choice("scale", "Scale", Object.entries(SCALES).map(([key, scale]) => [key, scale.name])),
      range("exposure", "Exposure, stops", -4, 8, 0.5),
      choice("tool", "A click marks", [["pixel", "a pixel"], ...Object.entries(REGIONS).map(([kind, { name }]) => [kind, "a " + name.toLowerCase()])]),
      html("div", { class: "cbv-zoom", role: "group", "aria-label": "Zoom" }, [
        button("out", "−", () => this._zoom(1 / 1.5)), html("output", { "data-cbv": "zoomed" }),
        button("in", "+", () => this._zoom(1.5)), button("whole", "whole", () => this.set({ zoom: 1 })),
      ]),
      html("div", { class: "cbv-zoom", role: "group", "aria-label": "Save" }, [
        button("png", "PNG", () => this._savePictures()), button("csv", "CSV", () => this._saveTable("panes")),
      ]),
    ]);
    this._controls.querySelector("[data-cbv=out]").setAttribute("aria-label", "Zoom out");
    this._controls.querySelector("[data-cbv=in]").setAttribute("aria-label", "Zoom in");
    this._figures = html("div", { class: "cbv-panes" });
    this._split = range("split", "Share of A", 0, 100, 1);
    this._flip = button("flip", "", () => this.flip());
    this._hover = html("p", { class: "cbv-hover", "aria-hidden": "true" }, " ");
    this._status = html("p", { class: "cbv-status", role: "status" });
    this._panel = html("section", { class: "cbv-pixel", "aria-label": "Pixel" });
    this._regionPanel = html("section", { class: "cbv-pixel", "aria-label": "Region" });
    this._regionContent = html("div");
    this._regionPanel.append(this._regionContent, html("div", { class: "cbv-zoom" }, [
      button("region-csv", "CSV of this region", () => this._saveTable("region")),
      button("region-clear", "Clear", () => this.set({ region: null })),
    ]));
    this._panel.hidden = this._regionPanel.hidden = true;
    const size = this.picture.block || 1;
    const note = size === 1 ? [] : [html("p", { class: "cbv-help" },
      `The picture is large: each pixel here is the mean of ${size} × ${size} pixels of the capture.`)];
    const help = html("details", { class: "cbv-help" }, [
      html("summary", {}, "Keys"),
      html("p", {}, "With the focus on a picture: arrows move the marked pixel, Shift + arrows the picture; + and − zoom, 0 " +
        "shows the whole; F flips A and B; , and . move the line of the slider; Enter adds the marked pixel to a region; Escape " +
        "closes pixel and region. The wheel zooms with Ctrl, or once a picture has the focus; drag to move it. A rectangle " +
        "or a line is dragged, or has two clicks; every click adds a corner to a polygon."),
    ]);
    const bar = html("div", { class: "cbv-ab" }, [this._split, this._flip]);
    const main = html("div", {}, [this._figures, bar, ...note, this._hover]);
    this._body = html("div", { class: "cbv-body" }, [main, html("div", { class: "cbv-side" }, [this._panel, this._regionPanel])]);
    this.element.replaceChildren(this._controls, this._body, this._status, help);
    this._fillLists();
  }

  _fillLists() {
    for (const name of ["a", "b", "c"]) {
      const select = this._controls.querySelector(`[data-cbv=${name}]`);
      select.replaceChildren(...layersOf(this.picture).map((layer) =>
        html("option", { value: layer.id, ...(layer.lacks ? { disabled: "" } : {}) }, layer.lacks || layer.name)));
    }
  }

  /** Show B in place of A, or A in place of B. */
  flip() {
    const { mode, a, b, showing } = this._state;
    if (mode === "flip") this.set({ showing: showing === "a" ? "b" : "a" });
    else this.set({ a: b, b: a });
  }

  _refresh() {
    const s = this._state;
    for (const input of this.element.querySelectorAll("select[data-cbv], input[data-cbv]")) {
      input.value = String(s[input.dataset.cbv]);
      const output = input.parentElement.querySelector("output");
      if (output) output.textContent = input.dataset.cbv === "split" ? unbroken(s.split.toFixed(0) + " %") : signed(s.exposure, 1);
    }
    this._controls.querySelector("[data-cbv=zoomed]").textContent = "× " + shown(s.zoom, 2);
    this._split.hidden = s.mode !== "slider";
    this._flip.hidden = s.mode !== "flip";
    this._flip.textContent = `Flip: showing ${s.showing.toUpperCase()}, ${this._layer(s[s.showing]).name}`;
    this._completeFlip().catch((error) => { this._status.textContent = error.message; });
    this._makePanes();
    this._body.dataset.side = Boolean(s.pixel || s.region);
    this._draw();
    const record = s.pixel && this.values(...s.pixel);
    this._panel.hidden = !record;
    this._regionPanel.hidden = !s.region;
    this._regionContent.replaceChildren(...(s.region ? regionPanel(this.picture, s.region, s.band) : []));
    this._panel.replaceChildren(...(record ? pixelPanel(this.picture, record) : []));
  }

  /** Ask for FLIP where it is shown and not known yet. */
  async _completeFlip() {
    if (this.picture.flip || this._flipAsked || !this._askFlip || !this._panes().flat().includes("flip")) return;
    this._flipAsked = true;
    const rendered = this.picture.rendered;
    const flip = await decoded(await this._askFlip());
    if (!flip || rendered !== this.picture.rendered) return;
    this.picture.flip = flip;
    for (const key of [...this._painted.keys()]) if (key.startsWith("flip ")) this._painted.delete(key);
    this._refresh();
  }

  _makePanes() {
    const panes = this._panes();
    while (this._figures.children.length > panes.length) this._figures.lastChild.remove();
    while (this._figures.children.length < panes.length) {
      const canvas = html("canvas", { tabindex: "0", role: "application", "aria-roledescription": "picture" });
      canvas.style.aspectRatio = `${this.picture.width} / ${this.picture.height}`;
      this._listen(canvas);
      const scales = ["cbv-down", "cbv-across"].map((name) => html("div", { class: name, "aria-hidden": "true" }));
      const unit = html("div", { class: "cbv-px", "aria-hidden": "true" }, "px");
      const framed = html("div", { class: "cbv-framed" }, [scales[0], canvas, unit, scales[1]]);
      this._figures.append(html("figure", {}, [html("figcaption"), framed, html("div", { class: "cbv-bars" })]));
    }
    this._figures.dataset.panes = panes.length;
    panes.forEach((ids, n) => {
      const figure = this._figures.children[n];
      const names = ids.map((id) => this._caption(id));
      figure.querySelector("figcaption").textContent = names.join(" | ");
      figure.querySelector("canvas").setAttribute("aria-label",
        `${names.join(", and right of the line ")}. Arrow keys mark a pixel and announce its values.`);
      const bars = ids.map((id) => this._bar(id)).filter(Boolean);
      figure.querySelector(".cbv-bars").replaceChildren(...bars);
    });
  }

  _caption(id) {
    const layer = this._layer(id);
    const { band, exposure } = this._state;
    const one = this.picture.bands[band];
    const name = one && (one.nm === null ? one.id : one.nm.toFixed(0) + " nm");
    if (layer.kind === "picture")
      return `${layer.name}, ${band === -1 ? "sRGB" : name || "XYZ"[-2 - band]}` +
        (exposure ? `, ${signed(exposure, 1)} stops` : "");
    if (layer.signal)
      return `${layer.name}, ${layer.unit ? signalName(this.picture, band).split(",")[0] + ", " + layer.unit : signalName(this.picture, band)}`;
    return layer.perBand || layer.kind === "reason" ? `${layer.name}, ${name || "all bands"}` : layer.name;
  }

  /** Colour bar or legend of a layer; nothing for colour pictures. */
  _bar(id) {
    const { scale, values } = this._paintedLayer(id);
    const layer = this._layer(id);
    if (layer.kind === "reason") {
      const found = this.picture.reasons.map((reason, k) => {
        let pixels = 0;
        for (const v of values) if (v & reason.bit) pixels++;
        const box = html("span", { class: "box", style: `background:${REASON_COLOURS[k % REASON_COLOURS.length]}` });
        return html("li", {}, [box, `${reason.name}: ${pixels} px`]);
      });
      return html("ul", { class: "cbv-legend" }, found);
    }
    if (!scale) return null;
    const stops = scale.table.filter((_, k) => k % 17 === 0).map((c) => `rgb(${c.join(" ")})`);
    const marks = ticks(scale.low, scale.high, 4).map((v) => {
      const place = (100 * (v - scale.low)) / (scale.high - scale.low);
      return html("span", { style: `left:${place.toFixed(2)}%` }, shown(v));
    });
    return html("div", { class: "cbv-bar", role: "img", "aria-label": `${layer.name}: scale from ${shown(scale.low)} to ${shown(scale.high)} ${scale.unit}` }, [
      html("div", { class: "ramp", style: `background:linear-gradient(to right, ${stops.join(", ")})` }),
      html("div", { class: "ticks" }, marks), html("div", { class: "unit" }, this._scaleText(id)),
    ]);
  }

  /** Name and unit of a layer's scale. */
  _scaleText(id) {
    const { scale, values } = this._paintedLayer(id);
    const { name, kind, red = "the photograph is brighter" } = this._layer(id);
    if (!scale) return "";
    const unit = name.endsWith(scale.unit) ? name : `${name}, ${scale.unit}`;
    const named = kind === "difference" ? `${unit}; red: ${red}` : unit;
    return values.some((v) => Number.isNaN(v)) ? `${named}; hatched: left out` : named;
  }

  // ---- drawing

  _geometry(canvas) {
    const { width, height } = canvas.getBoundingClientRect();
    const { x, y, zoom } = this._state;
    const cell = (width / this.picture.width) * zoom;
    return { width, height, cell, left: width / 2 - x * cell, top: height / 2 - y * cell };
  }

  _draw() {
    if (!this._figures) return;
    this._panes().forEach((ids, n) => {
      const canvas = this._figures.children[n] && this._figures.children[n].querySelector("canvas");
      if (canvas) this._drawPane(canvas, ids);
    });
  }

  _drawPane(canvas, ids) {
    const g = this._geometry(canvas);
    if (!g.width) return;
    this._drawAxes(canvas.parentElement, g);
    const ratio = window.devicePixelRatio || 1;
    [canvas.width, canvas.height] = [Math.round(g.width * ratio), Math.round(g.height * ratio)];
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.imageSmoothingEnabled = false;
    hatch(context, g.width, g.height);
    const line = ids.length > 1 ? (g.width * this._state.split) / 100 : g.width;
    ids.forEach((id, side) => {
      context.save();
      context.beginPath();
      if (side === 0) context.rect(0, 0, line, g.height);
      else context.rect(line, 0, g.width - line, g.height);
      context.clip();
      const layer = this._paintedLayer(id);
      context.drawImage(layer.canvas, g.left, g.top, g.cell * this.picture.width, g.cell * this.picture.height);
      if (g.cell >= 46) this._numbers(context, g, id, layer);
      context.restore();
    });
    if (ids.length > 1) {
      for (const [width, colour] of [[4, "#000"], [2, "#fff"]]) {
        context.fillStyle = colour;
        context.fillRect(line - width / 2, 0, width, g.height);
      }
      context.font = "600 13px system-ui, sans-serif";
      context.textBaseline = "top";
      [["A", line - 8, "right"], ["B", line + 8, "left"]].forEach(([text, x, align]) => {
        context.textAlign = align;
        outlined(context, text, x, 8);
      });
    }
    if (this._state.region)
      drawRegion(context, this._state.region, (x, y) => [g.left + (x + 0.5) * g.cell, g.top + (y + 0.5) * g.cell], g.cell);
    if (this._state.pixel) {
      const [x, y] = this._state.pixel;
      const size = Math.max(g.cell, 7);
      const middle = [g.left + (x + 0.5) * g.cell, g.top + (y + 0.5) * g.cell];
      for (const [grow, colour] of [[3, "#000"], [1, "#fff"]]) {
        context.lineWidth = grow === 3 ? 3 : 1.5;
        context.strokeStyle = colour;
        context.strokeRect(middle[0] - size / 2 - 1, middle[1] - size / 2 - 1, size + 2, size + 2);
      }
    }
  }

  /** Pixel numbers left of the picture and below it; a number stands at the centre of its pixel. */
  _drawAxes(framed, g) {
    const marks = (start, size, side) => {
      const [low, high] = [-start, size - start].map((v) => v / g.cell - 0.5);
      return ticks(low, high, Math.max(2, size / 70)).filter(Number.isInteger).map((v) => {
        const place = (100 * (start + (v + 0.5) * g.cell)) / size;
        return html("span", { style: `${side}:${place.toFixed(3)}%` }, String(v));
      });
    };
    framed.querySelector(".cbv-down").replaceChildren(...marks(g.top, g.height, "top"));
    framed.querySelector(".cbv-across").replaceChildren(...marks(g.left, g.width, "left"));
  }

  /** Numbers in the pixels, where these are large enough. */
  _numbers(context, g, id, layer) {
    const { width, height } = this.picture;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    const from = (start) => Math.max(0, Math.floor(-start / g.cell));
    for (let y = from(g.top); y < height && g.top + y * g.cell < g.height; y++)
      for (let x = from(g.left); x < width && g.left + x * g.cell < g.width; x++) {
        const i = y * width + x;
        const value = layer.values ? layer.values[i] : xyzOf(this.picture, this.picture[id], i)[1];
        if (!Number.isFinite(value)) continue;
        const text = layer.values ? shown(value, 3) : "Y " + shown(value, 3);
        const [red, green, blue, alpha] = layer.rgba.subarray(4 * i, 4 * i + 4);
        context.fillStyle = !alpha || 0.3 * red + 0.59 * green + 0.11 * blue > 120 ? "#000" : "#fff";
        context.fillText(text, g.left + (x + 0.5) * g.cell, g.top + (y + 0.5) * g.cell, g.cell - 6);
      }
  }

  // ---- input

  _place(canvas, event) {
    const box = canvas.getBoundingClientRect();
    const g = this._geometry(canvas);
    const at = [event.clientX - box.left, event.clientY - box.top];
    const x = Math.floor((at[0] - g.left) / g.cell);
    const y = Math.floor((at[1] - g.top) / g.cell);
    const inside = x >= 0 && y >= 0 && x < this.picture.width && y < this.picture.height;
    const within = (v, size) => Math.min(Math.max(v, 0), size - 1);
    const nearest = [within(x, this.picture.width), within(y, this.picture.height)];
    return { at, g, pixel: inside ? [x, y] : null, nearest };
  }

  /** Zoom by a factor about a point of the picture, in px; about the marked pixel or the middle where left out. */
  _zoom(factor, about) {
    const s = this._state;
    const [x, y] = about || (s.pixel ? s.pixel.map((v) => v + 0.5) : [s.x, s.y]);
    const before = s.zoom;
    const zoom = Math.min(Math.max(before * factor, 1), Math.max(this.picture.width, this.picture.height) / 4);
    this.set({ zoom, x: x + (s.x - x) * (before / zoom), y: y + (s.y - y) * (before / zoom) });
  }

  _listen(canvas) {
    const pointers = new Map();
    let start = null;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      const { at, g, pixel } = this._place(canvas, event);
      const { mode, split, x, y, tool } = this._state;
      const onLine = mode === "slider" && tool === "pixel" && Math.abs(at[0] - (g.width * split) / 100) < 16;
      const from = ["rectangle", "line"].includes(tool) ? pixel : null;
      start = { at, x, y, onLine, from, moved: false, spread: null };
    });
    canvas.addEventListener("pointermove", (event) => {
      const { at, g, pixel, nearest } = this._place(canvas, event);
      this._tell(pixel);
      if (!start || !pointers.has(event.pointerId)) return;
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      if (pointers.size === 2) {
        const [p, q] = [...pointers.values()];
        const spread = Math.hypot(p[0] - q[0], p[1] - q[1]);
        if (start.spread) this._zoom(spread / start.spread, [(at[0] - g.left) / g.cell, (at[1] - g.top) / g.cell]);
        Object.assign(start, { spread, moved: true });
        return;
      }
      const by = [at[0] - start.at[0], at[1] - start.at[1]];
      if (Math.hypot(...by) > 4) start.moved = true;
      if (!start.moved || start.spread) return;
      if (start.from) this.mark(nearest, start.from);
      else if (start.onLine) this.set({ split: (100 * at[0]) / g.width });
      else if (this._state.zoom > 1) this.set({ x: start.x - by[0] / g.cell, y: start.y - by[1] / g.cell });
    });
    const end = (event) => {
      pointers.delete(event.pointerId);
      const { pixel } = this._place(canvas, event);
      if (start && !start.moved && event.type === "pointerup" && pixel) {
        if (this._state.tool === "pixel") this.select(...pixel);
        else this.mark(pixel);
      }
      if (!pointers.size) start = null;
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => this._tell(null));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return;
      event.preventDefault();
      const { at, g } = this._place(canvas, event);
      this._zoom(2 ** (-event.deltaY / 300), [(at[0] - g.left) / g.cell, (at[1] - g.top) / g.cell]);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this._key(event));
  }

  /** The line under the pictures: where the pointer is and what the layers have there. */
  _tell(pixel) {
    if (!pixel) return void (this._hover.textContent = " ");
    const i = pixel[1] * this.picture.width + pixel[0];
    const parts = this._panes().flat().map((id) => {
      const { values, scale } = this._paintedLayer(id);
      const name = this._layer(id).name;
      if (!values) return `${name} Y ${shown(xyzOf(this.picture, this.picture[id], i)[1], 4)} ${this.picture.xyz_unit}`;
      if (!scale) return `${name}: ${this.picture.reasons.filter((r) => values[i] & r.bit).map((r) => r.name).join(", ") || "used"}`;
      return `${name} ${shown(values[i], 4)} ${scale.unit}`;
    });
    this._hover.textContent = unbroken(`${pixel[0]}, ${pixel[1]} ${surfaceName(this.picture, i)}: ${parts.join(" · ")}`);
  }

  _key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const s = this._state;
    const { width, height } = this.picture;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const act = {
      "+": () => this._zoom(1.5), "=": () => this._zoom(1.5), "-": () => this._zoom(1 / 1.5),
      0: () => this.set({ zoom: 1 }), f: () => this.flip(), F: () => this.flip(),
      ",": () => this.set({ split: s.split - 1 }), ".": () => this.set({ split: s.split + 1 }),
      Enter: () => s.tool !== "pixel" && s.pixel && this.mark([...s.pixel]),
      Escape: () => { s.region = null; this.select(null); },
    }[event.key];
    if (arrow && event.shiftKey) {
      this.set({ x: s.x + (0.1 * arrow[0] * width) / s.zoom, y: s.y + (0.1 * arrow[1] * height) / s.zoom });
    } else if (arrow) {
      const step = Math.max(1, Math.round((0.01 * width) / s.zoom));
      const from = s.pixel || [Math.floor(s.x) - arrow[0] * step, Math.floor(s.y) - arrow[1] * step];
      const inside = (v, size) => Math.min(Math.max(v, 0), size - 1);
      const pixel = [inside(from[0] + step * arrow[0], width), inside(from[1] + step * arrow[1], height)];
      const out = (v, centre, size) => Math.abs(v + 0.5 - centre) > size / 2 / s.zoom;
      if (out(pixel[0], s.x, width)) s.x = pixel[0] + 0.5;
      if (out(pixel[1], s.y, height)) s.y = pixel[1] + 0.5;
      this.select(...pixel);
    } else if (act) act();
    else return;
    event.preventDefault();
  }
}

/** The ground on which pixels without a value stand out. */
function hatch(context, width, height) {
  context.fillStyle = "#d8d8d8";
  context.fillRect(0, 0, width, height);
  context.strokeStyle = "#9a9a9a";
  context.lineWidth = 1;
  context.beginPath();
  for (let x = -height; x < width; x += 6) {
    context.moveTo(x, height);
    context.lineTo(x + height, 0);
  }
  context.stroke();
}

/** White text with a dark edge: readable on any colour. */
function outlined(context, text, x, y) {
  context.lineJoin = "round";
  context.lineWidth = 3.5;
  context.strokeStyle = "#000";
  context.strokeText(text, x, y);
  context.fillStyle = "#fff";
  context.fillText(text, x, y);
}
