"""The report's frame once more: all pairs, double precision, one sphere after the other, written from its description
alone. Slow and plain, to be compared with the engine's over a few frames."""

from dataclasses import dataclass

import numpy as np
from reference.all_pairs import overlapping_pairs


@dataclass
class Scene:
    """Arrays as in fastcollide.Spheres, in double precision; the other names as in fastcollide.World."""

    position: np.ndarray
    velocity: np.ndarray
    radius: np.ndarray
    mass: np.ndarray
    restitution: np.ndarray
    bounds: tuple
    gravity: tuple
    drag: float
    floor_restitution: float
    wall_friction: float
    iterations: int


def simulate(scene, frames, dt):
    """Changes position and velocity of the scene."""
    for _ in range(frames):
        fly(scene, dt)
        for i in range(len(scene.radius)):
            hit_walls(scene, i)
        for _ in range(scene.iterations):
            resolve_contacts(scene)


def fly(scene, dt):
    gravity = np.array(scene.gravity)
    scene.position += scene.velocity * dt + 0.5 * gravity * dt**2
    scene.velocity = (scene.velocity + gravity * dt) * np.exp(-scene.drag * dt)


def hit_walls(scene, i):
    position, velocity = scene.position[i], scene.velocity[i]
    for axis in range(3):
        for side, inwards in ((0, 1.0), (1, -1.0)):
            limit = scene.bounds[side][axis] + inwards * scene.radius[i]
            if inwards * (position[axis] - limit) >= 0:
                continue
            position[axis] = limit
            approach = -inwards * velocity[axis]
            if approach <= 0:
                continue
            is_floor = axis == 2 and side == 0
            restitution = scene.floor_restitution if is_floor else scene.restitution[i]
            velocity[axis] = inwards * restitution * approach
            # Coulomb: the tangential impulse is at most the friction coefficient times the normal one.
            tangential = np.delete(np.arange(3), axis)
            speed = np.linalg.norm(velocity[tangential])
            if speed > 0:
                stopped = min(speed, scene.wall_friction * (1 + restitution) * approach)
                velocity[tangential] *= (speed - stopped) / speed


def resolve_contacts(scene):
    """Every contact acts on the state as it was before this pass; the changes of one sphere add up."""
    displacement, velocity_change = np.zeros_like(scene.position), np.zeros_like(scene.velocity)
    for i, j in zip(*overlapping_pairs(scene.position, scene.radius), strict=True):
        offset = scene.position[j] - scene.position[i]
        distance = np.linalg.norm(offset)
        normal = offset / distance
        depth = scene.radius[i] + scene.radius[j] - distance
        total = scene.mass[i] + scene.mass[j]
        displacement[i] -= normal * depth * scene.mass[j] / total
        displacement[j] += normal * depth * scene.mass[i] / total
        approach = (scene.velocity[i] - scene.velocity[j]) @ normal
        if approach > 0:
            restitution = min(scene.restitution[i], scene.restitution[j])
            impulse = (1 + restitution) * approach * scene.mass[i] * scene.mass[j] / total
            velocity_change[i] -= normal * impulse / scene.mass[i]
            velocity_change[j] += normal * impulse / scene.mass[j]
    scene.position += displacement
    scene.velocity += velocity_change
    lowest = np.array(scene.bounds[0]) + scene.radius[:, None]
    highest = np.array(scene.bounds[1]) - scene.radius[:, None]
    scene.position = np.clip(scene.position, lowest, highest)
