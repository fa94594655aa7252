// The sphere that a ray meets first, or -1. In double precision, with the miss distance for accuracy far away.
export function pick({ eye, ray }, positions, radii) {
  let found = -1;
  let nearest = Infinity;
  for (let i = 0; i < radii.length; ++i) {
    const x = positions[3 * i] - eye[0], y = positions[3 * i + 1] - eye[1], z = positions[3 * i + 2] - eye[2];
    const along = x * ray[0] + y * ray[1] + z * ray[2];
    if (along < 0) continue;
    const mx = x - along * ray[0], my = y - along * ray[1], mz = z - along * ray[2];
    const inside = radii[i] * radii[i] - (mx * mx + my * my + mz * mz);
    if (inside < 0) continue;
    const depth = along - Math.sqrt(inside);
    if (depth > 0 && depth < nearest) {
      nearest = depth;
      found = i;
    }
  }
  return found;
}
