"""Hard spheres by exact event-driven dynamics, in double precision: from collision to collision without a time step.

B. J. Alder and T. E. Wainwright, J. Chem. Phys. 31, 459 (1959). In its simplest form, for some hundred spheres of
diameter 1 and mass 1 in a periodic cube.
"""

import numpy as np
from numpy.typing import NDArray


class EventDrivenGas:
    def __init__(self, position: NDArray, velocity: NDArray, edge: float, restitution: float) -> None:
        self.position, self.velocity = position.astype(np.float64), velocity.astype(np.float64)
        self.edge, self.restitution = edge, restitution
        self.time = 0.0
        count = len(position)
        self._next_time = np.full(count, np.inf)  # of the next collision of each sphere, and with whom
        self._partner = np.full(count, -1)
        for i in range(count):
            self._predict(i)

    def advance_to(self, time: float) -> None:
        while (event := self._next_time.min()) <= time:
            self._fly_to(event)
            self._collide(int(self._next_time.argmin()))
        self._fly_to(time)

    def temperature(self) -> float:
        return float((self.velocity**2).sum() / (3 * (len(self.velocity) - 1)))

    def _fly_to(self, time: float) -> None:
        self.position += self.velocity * (time - self.time)
        self.time = time

    def _collide(self, i: int) -> None:
        j = int(self._partner[i])
        normal = self._nearest(self.position[j] - self.position[i])
        normal /= np.linalg.norm(normal)
        impulse = normal * (1 + self.restitution) / 2 * ((self.velocity[j] - self.velocity[i]) @ normal)
        self.velocity[i] += impulse
        self.velocity[j] -= impulse
        outdated = np.flatnonzero(np.isin(self._partner, (i, j)) | np.isin(np.arange(len(self._partner)), (i, j)))
        self._next_time[outdated], self._partner[outdated] = np.inf, -1
        for k in outdated:
            self._predict(int(k))

    def _predict(self, i: int) -> None:
        """|offset + relative t| = 1 with the nearest image of each other sphere: far less than a box is flown between
        two predictions."""
        offset = self._nearest(self.position - self.position[i])
        relative = self.velocity - self.velocity[i]
        along, squared = (offset * relative).sum(axis=1), (relative**2).sum(axis=1)
        gap = (offset**2).sum(axis=1) - 1
        root = along**2 - squared * gap
        meets = (along < 0) & (root > 0)
        meets[i] = False
        time = np.full(len(along), np.inf)
        time[meets] = self.time + np.maximum(gap[meets], 0) / (np.sqrt(root[meets]) - along[meets])
        sooner = time < self._next_time
        sooner[i] = False
        self._next_time[sooner], self._partner[sooner] = time[sooner], i
        self._partner[i] = time.argmin()
        self._next_time[i] = time[self._partner[i]]

    def _nearest(self, offset: NDArray) -> NDArray:
        return offset - self.edge * np.round(offset / self.edge)
