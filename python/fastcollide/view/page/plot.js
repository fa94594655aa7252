// Energies against time, as lines on a canvas.

const LINES = [
  { name: "total", color: { light: "#1d2530", dark: "#e9edf3" }, of: (row) => row[1] + row[2] + row[3] },
  { name: "kinetic", color: { light: "#d9622b", dark: "#ff9d66" }, of: (row) => row[1] },
  { name: "rotational", color: { light: "#8e44ad", dark: "#d7a3f0" }, of: (row) => row[2], isOptional: true },
  { name: "potential", color: { light: "#3d63dd", dark: "#8da6ff" }, of: (row) => row[3] },
];

export class Plot {
  constructor(canvas, legend) {
    this.canvas = canvas;
    this.legend = legend;
    this.rows = []; // time [s], kinetic, rotational, potential [J]
    this.time = 0;
    this.theme = "light";
  }

  add(from, rows) {
    this.rows.length = from;
    this.rows.push(...rows);
  }

  draw() {
    const { canvas, rows } = this;
    if (!canvas.clientWidth) return;
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    Object.assign(canvas, { width: Math.round(width * scale), height: Math.round(height * scale) });
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    const shown = LINES.filter((line) => !line.isOptional || rows.some((row) => line.of(row) > 0));
    const values = shown.map((line) => rows.map(line.of));
    const most = Math.max(...values.map((all) => all.reduce((a, b) => Math.max(a, b), -Infinity)), 0);
    const least = Math.min(...values.map((all) => all.reduce((a, b) => Math.min(a, b), Infinity)), 0);
    const [first, last] = rows.length ? [rows[0][0], rows[rows.length - 1][0]] : [0, 1];
    const styles = getComputedStyle(canvas);
    const [ink, grid] = [styles.getPropertyValue("--soft"), styles.getPropertyValue("--line")];
    const bottom = height - 16, top = 14;
    const x = (time) => ((time - first) / (last - first || 1)) * (width - 2) + 1;
    const y = (value) => bottom - ((value - least) / (most - least || 1)) * (bottom - top);

    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = ink;
    pen.strokeStyle = grid;
    pen.beginPath();
    for (const value of new Set([0, most])) {
      pen.moveTo(0, y(value));
      pen.lineTo(width, y(value));
    }
    pen.stroke();
    pen.fillText(joules(most), 0, y(most) - 3);
    pen.fillText(`${first.toFixed(1)} s`, 0, height - 3);
    pen.textAlign = "right";
    pen.fillText(`${last.toFixed(1)} s`, width, height - 3);
    pen.lineWidth = 1.6;
    pen.lineJoin = "round";
    [...shown.entries()].reverse().forEach(([i, line]) => {
      pen.strokeStyle = line.color[this.theme];
      pen.beginPath();
      rows.forEach((row, k) => pen.lineTo(x(row[0]), y(values[i][k])));
      pen.stroke();
    });
    if (rows.length && this.time < last) {
      pen.strokeStyle = ink;
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(x(this.time), top);
      pen.lineTo(x(this.time), bottom);
      pen.stroke();
    }
    this.#write(shown, rows.findLast((row) => row[0] <= this.time + 1e-9) ?? rows[0]);
  }

  #write(shown, row) {
    this.legend.replaceChildren(...shown.flatMap((line) => {
      const [name, value] = [document.createElement("dt"), document.createElement("dd")];
      name.textContent = line.name;
      name.style.setProperty("--line-color", line.color[this.theme]);
      value.textContent = row ? joules(line.of(row)) : "";
      return [name, value];
    }));
  }
}

export function joules(value) {
  const size = Math.abs(value);
  const [unit, factor] = size >= 1e6 ? ["MJ", 1e6] : size >= 1e3 ? ["kJ", 1e3] : size >= 1 || size === 0 ? ["J", 1] : ["mJ", 1e-3];
  return `${(value / factor).toPrecision(4)} ${unit}`;
}
