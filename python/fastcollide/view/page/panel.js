// What stands beside the picture: sliders, legend, a sphere's data.

export const $ = (id) => document.getElementById(id);

const UNITS = { speed: "m/s", radius: "m", id: "number", contacts: "contacts" };
const CONDITION_UNITS = { gravity: " m/s²", drag: " 1/s" };
const DATA = [
  ["position", "m"], ["velocity", "m/s"], ["speed", "m/s"], ["spin", "rad/s"], ["radius", "m"], ["mass", "kg"],
  ["restitution", ""], ["friction", ""],
];

export class Sliders {
  // change(conditions): called whenever a slider moves.
  constructor(change) {
    this.inputs = [...document.querySelectorAll("#conditions input")];
    this.gravity = [0, 0, 0];
    this.conditions = {};
    for (const input of this.inputs) {
      input.addEventListener("input", () => {
        const value = Number(input.value);
        this.#write(input, value);
        change({ [input.id]: input.id === "gravity" ? [this.gravity[0], this.gravity[1], value] : value });
      });
    }
  }

  show(conditions) {
    this.conditions = conditions;
    $("conditions").hidden = !Object.keys(conditions).length;
    if (conditions.gravity) this.gravity = conditions.gravity;
    for (const input of this.inputs) {
      const value = input.id === "gravity" ? conditions.gravity?.[2] : conditions[input.id];
      input.closest(".slider").hidden = value === undefined;
      if (value === undefined || input.matches(":active")) continue;
      if (value !== null) input.value = value;
      this.#write(input, value);
    }
  }

  // A change was refused: what holds is what held before.
  showAgain() {
    this.show(this.conditions);
  }

  #write(input, value) {
    const text = value === null ? "each its own" : `${Number(value.toFixed(3))}${CONDITION_UNITS[input.id] ?? ""}`;
    input.previousElementSibling.textContent = text;
  }
}

export function showLegend(colors, colorBy, range) {
  const pen = $("legend").getContext("2d");
  const strip = pen.createImageData(256, 10);
  for (let i = 0; i < 2560; ++i) {
    const shade = 3 * (i % 256);
    strip.data.set([colors[shade], colors[shade + 1], colors[shade + 2], 255], 4 * i);
  }
  pen.putImageData(strip, 0, 0);
  $("legend-low").textContent = short(range[0]);
  $("legend-high").textContent = short(range[1]) + (colorBy === "contacts" ? " or more" : "");
  $("legend-unit").textContent = UNITS[colorBy];
}

export function showSphere(sphere) {
  $("sphere-name").textContent = `Sphere ${sphere.id}`;
  const rows = DATA.filter(([name]) => sphere[name] !== undefined).map(([name, unit]) => [name, unit, words(sphere[name])]);
  const ids = sphere.contacts;
  rows.push(["contacts", "", ids.length ? `${ids.length}: ${ids.slice(0, 12).join(", ")}${ids.length > 12 ? ", …" : ""}` : "none"]);
  $("sphere-data").replaceChildren(...rows.flatMap(([name, unit, text]) => {
    const [label, value] = [document.createElement("dt"), document.createElement("dd")];
    label.textContent = unit ? `${name} (${unit})` : name;
    value.textContent = text;
    value.dataset.name = name;
    return [label, value];
  }));
}

function words(value) {
  if (typeof value === "string") return value;
  return Array.isArray(value) ? value.map((component) => Number(component.toFixed(3))).join(", ") : short(value);
}

function short(value) {
  return String(Number(value.toPrecision(4)));
}
