"""A cell list as a textbook has it, in CUDA through CuPy: what `search_gpu.py` compares with.

Cells as long as the largest diameter; a counting sort puts the spheres into cell order; a thread for each sphere looks
at 27 cells twice, to count and to fill, and sorts its few entries. Distances are compared in single precision and the
hits confirmed in double, so that the answer is the same as FastCollide's, in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

SOURCE = r"""
struct Grid { float edge; int cells; };

__device__ int along(float x, Grid grid) {
  const int cell = (int)floorf(x / grid.edge);
  return cell < 0 ? 0 : cell < grid.cells ? cell : grid.cells - 1;
}

extern "C" __global__ void count_cells(int n, const float* position, float edge, int cells, unsigned int* cell_of,
                                       unsigned int* place, unsigned int* count) {
  const long long i = (long long)blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= n) return;
  const Grid grid = {edge, cells};
  const unsigned int cell = along(position[3 * i], grid) +
      (unsigned int)cells * (along(position[3 * i + 1], grid) + (unsigned int)cells * along(position[3 * i + 2], grid));
  cell_of[i] = cell;
  place[i] = atomicAdd(count + cell, 1u);
}

extern "C" __global__ void fill_cells(int n, const float* position, const float* radius, float common_radius,
                                      const unsigned int* cell_of, const unsigned int* place,
                                      const unsigned int* cell_start, float4* sorted, int* ids) {
  const long long i = (long long)blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= n) return;
  const unsigned int slot = cell_start[cell_of[i]] + place[i];
  float4 sphere;
  sphere.x = position[3 * i];
  sphere.y = position[3 * i + 1];
  sphere.z = position[3 * i + 2];
  sphere.w = radius ? radius[i] : common_radius;
  sorted[slot] = sphere;
  ids[slot] = (int)i;
}

__device__ bool touches(float4 a, float4 b, int inclusive) {
  const float dx = b.x - a.x, dy = b.y - a.y, dz = b.z - a.z, reach = a.w + b.w;
  if (dx * dx + dy * dy + dz * dz > reach * reach * 1.00001f) return false;
  const double x = (double)b.x - a.x, y = (double)b.y - a.y, z = (double)b.z - a.z, limit = (double)a.w + b.w;
  const double squared = __dadd_rn(__dadd_rn(__dmul_rn(x, x), __dmul_rn(y, y)), __dmul_rn(z, z));
  return squared < limit * limit || (inclusive && squared == limit * limit);
}

// counts the partners of each sphere, or writes them from its offset on and sorts them. both: all, else those with a
// larger index; the limit itself counts then, too.
extern "C" __global__ void find(int n, float edge, int cells, const unsigned int* cell_start, const float4* sorted,
                                const int* ids, int both, int is_filling, int* row_counts,
                                const long long* row_start, int* rows, int* columns) {
  const long long slot = (long long)blockIdx.x * blockDim.x + threadIdx.x;
  if (slot >= n) return;
  const Grid grid = {edge, cells};
  const float4 sphere = sorted[slot];
  const int id = ids[slot];
  const int x = along(sphere.x, grid), y = along(sphere.y, grid), z = along(sphere.z, grid);
  const long long start = is_filling ? row_start[id] : 0;
  int found = 0;
  for (int cz = z - 1; cz <= z + 1; ++cz) {
    for (int cy = y - 1; cy <= y + 1; ++cy) {
      for (int cx = x - 1; cx <= x + 1; ++cx) {
        if (cx < 0 || cy < 0 || cz < 0 || cx >= cells || cy >= cells || cz >= cells) continue;
        const unsigned int cell = cx + (unsigned int)cells * (cy + (unsigned int)cells * cz);
        for (unsigned int other = cell_start[cell]; other < cell_start[cell + 1]; ++other) {
          const int other_id = ids[other];
          if (both ? other_id == id : other_id <= id) continue;
          if (!touches(sphere, sorted[other], both)) continue;
          if (is_filling) {
            long long hole = start + found;
            for (; hole > start && columns[hole - 1] > other_id; --hole) columns[hole] = columns[hole - 1];
            columns[hole] = other_id;
            if (rows) rows[start + found] = id;
          }
          ++found;
        }
      }
    }
  }
  if (!is_filling) row_counts[id] = found;
}
"""


@dataclass(frozen=True)
class PlainPairs:
    first: Any
    second: Any


@dataclass(frozen=True)
class PlainRows:
    offsets: Any
    indices: Any


class PlainCellList:
    """cells: of the cube from 0 to `side`; largest: radius."""

    def __init__(self, cupy: Any, side: float, largest: float) -> None:
        self._cupy = cupy
        module = cupy.RawModule(code=SOURCE)
        self._count_cells, self._fill_cells, self._find = map(
            module.get_function, ("count_cells", "fill_cells", "find")
        )
        self._edge = cupy.float32(2 * largest * 1.00001)  # rounding must not lose a partner two cells away
        self._cells = cupy.int32(max(1, int(side / float(self._edge))))

    def pairs(self, position: Any, radius: Any) -> PlainPairs:
        """All pairs that touch, sorted."""
        first, second, _ = self._search(position, radius, both=False)
        return PlainPairs(first, second)

    def neighbors(self, position: Any, radius: Any) -> PlainRows:
        """Of each sphere those that touch it, ascending."""
        _, indices, offsets = self._search(position, radius, both=True)
        return PlainRows(offsets, indices)

    def _search(self, position: Any, radius: Any, both: bool) -> tuple[Any, Any, Any]:
        cupy, n = self._cupy, len(position)
        radii, common = (radius, 0.0) if hasattr(radius, "shape") else (None, radius)
        count = cupy.zeros(int(self._cells) ** 3, cupy.uint32)
        cell_of, place = cupy.empty(n, cupy.uint32), cupy.empty(n, cupy.uint32)
        sorted_spheres, ids = cupy.empty((n, 4), cupy.float32), cupy.empty(n, cupy.int32)
        size, blocks, threads = cupy.int32(n), ((n + 127) // 128,), (128,)
        self._count_cells(blocks, threads, (size, position, self._edge, self._cells, cell_of, place, count))
        cell_start = cupy.zeros(len(count) + 1, cupy.uint32)
        cupy.cumsum(count, dtype=cupy.uint32, out=cell_start[1:])
        no_array = cupy.intp(0)
        self._fill_cells(
            blocks, threads,
            (size, position, no_array if radii is None else radii, cupy.float32(common), cell_of, place, cell_start,
             sorted_spheres, ids),
        )  # fmt: skip
        row_counts = cupy.empty(n, cupy.int32)
        given = (size, self._edge, self._cells, cell_start, sorted_spheres, ids, cupy.int32(both))
        self._find(blocks, threads, (*given, cupy.int32(0), row_counts, no_array, no_array, no_array))
        offsets = cupy.zeros(n + 1, cupy.int64)
        cupy.cumsum(row_counts, dtype=cupy.int64, out=offsets[1:])
        total = int(offsets[-1])
        columns = cupy.empty(total, cupy.int32)
        rows = None if both else cupy.empty(total, cupy.int32)
        self._find(
            blocks, threads,
            (*given, cupy.int32(1), row_counts, offsets, no_array if rows is None else rows, columns),
        )  # fmt: skip
        return rows, columns, offsets
