/* A photograph on a canvas that a page draws over, with zoom and brightness. Positions are px; a pixel's centre is whole. */
"use strict";

class Photograph {
  /**
   * host: element that gets the picture and its controls. label: name of the canvas, with its keys.
   * over(context, at): draws over the photograph; at(u, v) is a point of the canvas.
   */
  constructor(host, label, over) {
    this.over = over;
    this.zoom = 4;
    const button = (name, text, factor) => {
      const element = make("button", { type: "button", "aria-label": name }, text);
      element.addEventListener("click", () => this.zoomBy(factor));
      return element;
    };
    this.gain = make("input", { type: "range", min: -2, max: 4, step: 0.25, value: 0 });
    this.gain.addEventListener("input", () => this.draw());
    this.zoomed = make("output");
    this.canvas = make("canvas", { id: "photograph", tabindex: 0, role: "application", "aria-label": label });
    host.replaceChildren(
      make("div", { class: "row" }, [button("Zoom out", "−", 0.5), this.zoomed, button("Zoom in", "+", 2),
        make("label", {}, ["Brightness ", this.gain])]),
      make("div", { id: "scroll" }, [this.canvas]));
  }

  /** Show another picture: width, height, and its values row by row, 1 is white. */
  show(width, height, values) {
    Object.assign(this, { width, height, values });
    this.zoom = Math.max(1, Math.round(640 / width));
    this.draw();
  }

  zoomBy(factor) {
    this.zoom = Math.min(Math.max(Math.round(this.zoom * factor), 1), Math.floor(4096 / this.width));
    this.draw();
  }

  /** Position [u, v] of an event of the pointer. */
  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / this.zoom - 0.5, (event.clientY - box.top) / this.zoom - 0.5];
  }

  /** The position that is in the picture and nearest to [u, v]. */
  inside([u, v]) {
    const within = (value, size) => Math.min(Math.max(value, -0.5), size - 0.51);
    return [within(u, this.width), within(v, this.height)];
  }

  draw() {
    if (!this.values) return; // the picture is still on its way
    const { width, height, zoom, canvas } = this;
    const gain = 2 ** Number(this.gain.value);
    const image = new ImageData(width, height);
    this.values.forEach((value, i) => {
      const shade = 255 * Math.min(Math.max(gain * value, 0), 1) ** (1 / 2.2);
      image.data.set([shade, shade, shade, 255], 4 * i);
    });
    const small = new OffscreenCanvas(width, height);
    small.getContext("2d").putImageData(image, 0, 0);
    [canvas.width, canvas.height] = [width * zoom, height * zoom];
    const context = canvas.getContext("2d");
    context.imageSmoothingEnabled = false;
    context.drawImage(small, 0, 0, canvas.width, canvas.height);
    this.over(context, (u, v) => [(u + 0.5) * zoom, (v + 0.5) * zoom]);
    this.zoomed.textContent = "× " + zoom;
  }
}

/** Stroke a path in a colour with a dark rim, so that it is seen on every ground. */
function stroked(context, colour, path, width = 1) {
  for (const [line, stroke] of [[width + 2, "#000"], [width, colour]]) {
    context.lineWidth = line;
    context.strokeStyle = stroke;
    context.beginPath();
    path(context);
    context.stroke();
  }
}

/** A cross at a point of the canvas. */
function cross(context, [x, y], colour, size) {
  stroked(context, colour, (c) => {
    c.moveTo(x - size, y);
    c.lineTo(x + size, y);
    c.moveTo(x, y - size);
    c.lineTo(x, y + size);
  });
}

/** Change of a position [du, dv] by an arrow key, px; null for other keys. */
function arrowStep(event, step, fine) {
  const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  return arrow ? arrow.map((x) => x * (event.shiftKey ? fine : step)) : null;
}
