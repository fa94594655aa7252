// Mouse and touch on the canvas: turn, move, nearer and farther, click.

const CLICK_PIXELS = 6;

export function listen(canvas, camera, { changed, clicked, doubleClicked, moved }) {
  const pointers = new Map();
  let start = null; // of what may become a click
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, length: Math.hypot(a.x - b.x, a.y - b.y) };
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    start = pointers.size === 1 && event.button === 0 ? { x: event.clientX, y: event.clientY } : null;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
    if (start && Math.hypot(event.clientX - start.x, event.clientY - start.y) > CLICK_PIXELS) start = null;
    if (pointers.size === 2) {
      const old = spread();
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      const now = spread();
      camera.zoom(old.length / Math.max(now.length, 1));
      camera.pan(now.x - old.x, now.y - old.y, canvas.clientHeight);
      moved();
    } else {
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (start) return;
      if (event.buttons & 2 || event.shiftKey) {
        camera.pan(dx, dy, canvas.clientHeight);
        moved();
      } else camera.turn(dx, dy);
    }
    changed();
  });
  const end = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    if (event.type === "pointerup" && start) clicked(event.offsetX, event.offsetY);
    start = null;
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("dblclick", (event) => doubleClicked(event.offsetX, event.offsetY));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.zoom(Math.exp(Math.min(Math.max(event.deltaY, -200), 200) * 0.0015));
    changed();
  }, { passive: false });
}
