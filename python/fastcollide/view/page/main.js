// The page: connects the server, the picture and the controls.
import { Camera } from "./camera.js";
import { Connection } from "./connection.js";
import { $, Sliders, showLegend, showSphere } from "./panel.js";
import { pick } from "./pick.js";
import { Plot } from "./plot.js";
import { listen } from "./pointer.js";
import { Renderer } from "./renderer.js";

const canvas = $("view");
const camera = new Camera();
const plot = new Plot($("plot"), $("plot-legend"));
let renderer, hello, radii;
let picture = null; // the one to be seen
let arrived = null; // the one to be drawn next
let undrawn = 0; // pictures that have arrived since the last one was drawn
let isDue = false;
let selected = null;
let isFollowing = false;
let drawn = []; // when the last pictures were drawn [ms]

function note(text) {
  $("note").textContent = text;
  $("note").hidden = !text;
  clearTimeout(note.timer);
  if (text) note.timer = setTimeout(() => ($("note").hidden = true), 8000);
}

try {
  renderer = new Renderer(canvas);
} catch (error) {
  note(error.message);
  clearTimeout(note.timer);
  throw error;
}

// --- Drawing: once for each picture of the screen, and only when there is something new ---

function redraw() {
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(draw);
}

function draw(now) {
  isDue = false;
  if (arrived) {
    picture = arrived;
    arrived = null;
    radii = picture.radii ?? radii;
    renderer.setSpheres(picture);
    showTime();
    countPictures(now);
  }
  if (!picture) return;
  if (isFollowing && selected < picture.positions.length / 3) {
    camera.target = [...picture.positions.subarray(3 * selected, 3 * selected + 3)];
  }
  camera.cssHeight = canvas.clientHeight;
  renderer.draw(camera);
  for (; undrawn; --undrawn) connection.send("ack");
}

function countPictures(now) {
  drawn.push(now);
  drawn = drawn.filter((time) => time > now - 2000);
  if (drawn.length > 2) $("fps").textContent = `${Math.round((1000 * (drawn.length - 1)) / (now - drawn[0]))} fps`;
}

function showTime() {
  $("time").textContent = `${picture.time.toFixed(2)} s`;
  $("frame").textContent = picture.frame;
  const line = $("timeline");
  line.max = picture.moments - 1;
  if (!line.matches(":active")) line.value = picture.index;
  plot.time = picture.time;
  if (!document.body.classList.contains("playing")) plot.draw(); // else as often as its rows come
}

// --- From the server ---

const connection = new Connection({
  hello(message) {
    hello = message;
    document.title = `${hello.title} · FastCollide`;
    $("title").textContent = hello.title;
    const spheres = `${hello.spheres.toLocaleString("en")} spheres`;
    $("about").textContent = [hello.title === spheres ? null : spheres, hello.device].filter(Boolean).join(" · ");
    const isSameBox = String([hello.lower, hello.upper]) === String([renderer.lower, renderer.upper]);
    renderer.setBox(hello.lower, hello.upper, hello.boundary[2] !== "periodic");
    renderer.setColors(hello.colors);
    if (!isSameBox) camera.setBox(hello.lower, hello.upper);
    if (selected !== null && selected >= hello.spheres) select(null);
    setColor($("color").value);
  },
  status(message) {
    document.body.classList.toggle("playing", message.playing);
    $("play").setAttribute("aria-label", message.playing ? "Pause" : "Play");
    $("rate").textContent = message.playing && message.rate ? `${message.rate.toFixed(2)}× real time` : "";
    if (!message.playing) drawn = [];
    if ([...$("speed").options].some((option) => Number(option.value) === message.speed)) $("speed").value = message.speed;
    sliders.show(message.conditions ?? {});
    $("state").textContent = message.state_hash ? `State hash ${message.state_hash}` : "";
    if (message.fault) note(message.fault);
  },
  picture(message) {
    message.radii ??= arrived?.radii; // of a picture that was never drawn
    arrived = message;
    ++undrawn;
    redraw();
  },
  energies(message) {
    plot.add(message.from, message.rows);
    $("energy").hidden = !plot.rows.length;
    plot.draw();
  },
  sphere(message) {
    if (message.id === selected) showSphere(message);
  },
  error(message) {
    note(message.message);
    sliders.showAgain();
  },
  lost() {
    note("The connection has ended. Start the program again, then open the address that it shows.");
    clearTimeout(note.timer);
    document.body.classList.remove("playing");
  },
});

// --- To the server ---

const sliders = new Sliders((conditions) => connection.sendSoon("change", conditions));
const order = (type) => () => connection.send(type);
const playOrPause = () => connection.send(document.body.classList.contains("playing") ? "pause" : "play");
const seek = (index) => connection.sendSoon("seek", { index });

function select(id) {
  selected = id;
  renderer.selected = id ?? -1;
  connection.send("select", { id });
  $("sphere").hidden = id === null;
  if (id === null) follow(false);
  else {
    $("sphere-name").textContent = `Sphere ${id}`;
    $("sphere-data").replaceChildren();
    if ($("panel").hidden) showPanel(true);
    $("panel").scrollTop = 0;
  }
  redraw();
}

function follow(isWanted) {
  isFollowing = isWanted && selected !== null;
  $("follow").setAttribute("aria-pressed", isFollowing);
  redraw();
}

function setColor(colorBy) {
  $("color").value = colorBy;
  renderer.colorBy = colorBy;
  renderer.range = hello.ranges[colorBy];
  showLegend(hello.colors, colorBy, renderer.range);
  connection.send("color", { by: colorBy });
  redraw();
}

function nextColor() {
  const { options, selectedIndex } = $("color");
  setColor(options[(selectedIndex + 1) % options.length].value);
}

// --- The page itself ---

function setTheme(theme) {
  document.documentElement.dataset.theme = plot.theme = renderer.theme = theme;
  plot.draw();
  redraw();
}

function toggleTheme() {
  const theme = renderer.theme === "dark" ? "light" : "dark";
  localStorage.setItem("fastcollide-theme", theme);
  setTheme(theme);
}

function showPanel(isShown) {
  $("panel").hidden = !isShown;
  $("show-panel").setAttribute("aria-expanded", isShown);
  keepFree();
  plot.draw();
}

// The box is shown where neither bars nor panel lie over it.
function keepFree() {
  const isNarrow = innerWidth <= 720;
  const panel = $("panel").hidden ? null : $("panel").getBoundingClientRect();
  camera.keepFree({
    left: 0,
    right: panel && !isNarrow ? innerWidth - panel.left : 0,
    top: document.querySelector("header").getBoundingClientRect().bottom,
    bottom: innerHeight - (panel && isNarrow ? panel.top : document.querySelector("footer").getBoundingClientRect().top),
  });
  redraw();
}

function screenshot() {
  if (!picture) return;
  renderer.draw(camera); // a canvas keeps what was drawn only until the screen shows it
  canvas.toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `fastcollide_${String(picture.frame).padStart(8, "0")}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
}

const sphereAt = (x, y) => {
  const found = picture ? pick(camera.ray(x, y, canvas.clientWidth, canvas.clientHeight), picture.positions, radii) : -1;
  return found < 0 ? null : found;
};

const keys = {
  " ": playOrPause,
  ArrowRight: order("step"),
  ArrowLeft: order("back"),
  Home: () => seek(0),
  End: () => seek(Number($("timeline").max)),
  r: order("reset"),
  c: nextColor,
  f: () => follow(!isFollowing),
  h: () => {
    camera.home();
    follow(false);
  },
  s: screenshot,
  t: toggleTheme,
  p: () => showPanel($("panel").hidden),
  "?": () => $("help").showModal(),
  Escape: () => select(null),
};

canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
canvas.addEventListener("webglcontextrestored", () => location.reload());
listen(canvas, camera, {
  changed: redraw,
  moved: () => follow(false),
  clicked: (x, y) => select(sphereAt(x, y)),
  doubleClicked(x, y) {
    select(sphereAt(x, y));
    follow(true);
  },
});
for (const type of ["reset", "back", "step"]) $(type).addEventListener("click", order(type));
$("play").addEventListener("click", playOrPause);
$("timeline").addEventListener("input", () => seek(Number($("timeline").value)));
$("speed").addEventListener("change", () => connection.send("speed", { factor: Number($("speed").value) }));
$("color").addEventListener("change", () => setColor($("color").value));
$("follow").addEventListener("click", () => follow(!isFollowing));
$("deselect").addEventListener("click", () => select(null));
$("screenshot").addEventListener("click", screenshot);
$("theme").addEventListener("click", toggleTheme);
$("show-help").addEventListener("click", () => $("help").showModal());
$("show-panel").addEventListener("click", () => showPanel($("panel").hidden));
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("help").open || event.target.matches("select")) return;
  if (event.target.matches("input") && /^(Arrow|Home|End)/.test(event.key)) return; // these move the slider
  if (event.target.matches("button") && event.key === " ") return; // this presses the button
  const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action) return;
  event.preventDefault();
  action();
});
new ResizeObserver(keepFree).observe(document.documentElement);
const prefersDark = matchMedia("(prefers-color-scheme: dark)");
prefersDark.addEventListener("change", () => localStorage.getItem("fastcollide-theme") ?? setTheme(prefersDark.matches ? "dark" : "light"));
setTheme(localStorage.getItem("fastcollide-theme") ?? (prefersDark.matches ? "dark" : "light"));
showPanel(innerWidth > 720);
