"""Boltzmann's equation for a homogeneous gas of elastic hard spheres, by direct simulation.

G. A. Bird, "Molecular Gas Dynamics and the Direct Simulation of Gas Flows" (1994), ch. 11: partners are drawn at
random, collide with a probability in proportion to their relative speed, and part in a random direction. There is no
space in it and no time: what it gives as a function of the collisions per sphere has no parameter.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray


def relax(velocity: NDArray[np.float64], until: float, seed: int) -> Iterator[tuple[float, NDArray[np.float64]]]:
    """(collisions of a sphere so far, velocities, shape (n, 3)), up to `until` collisions. n is even."""
    random = np.random.default_rng(seed)
    velocity, collisions = velocity.copy(), 0.0
    yield collisions, velocity
    while collisions < until:
        # A twentieth of the pairs at a time: whom a sphere has just hit hardly matters then.
        first, second = random.permutation(len(velocity))[: len(velocity) // 20 * 2].reshape(2, -1)
        relative = velocity[first] - velocity[second]
        speed = np.linalg.norm(relative, axis=1)
        hit = random.random(len(speed)) * speed.max() < speed
        first, second, speed = first[hit], second[hit], speed[hit]
        direction = random.normal(size=(len(speed), 3))
        direction *= (speed / np.linalg.norm(direction, axis=1))[:, None]
        center = (velocity[first] + velocity[second]) / 2
        velocity[first], velocity[second] = center + direction / 2, center - direction / 2
        collisions += 2 * len(speed) / len(velocity)
        yield collisions, velocity
