"""What stands where: two rows of houses, road and footways, parked vehicles, trees, poles, crates.

Everything is drawn from one seed in a fixed order, and every surface gets a texture of its own.
"""

import itertools
from functools import partial

import numpy as np

from graphgs.synth import facades, surfaces
from graphgs.synth.canvas import random_color
from graphgs.synth.course import CourseName, heading_of
from graphgs.synth.drive import Centerline
from graphgs.synth.solids import StreetBuilder

ROAD = 4.3  # [m] half width
FRONT = 7.0  # [m] nearest house front
FOOTWAY = 9.0  # [m] outer edge, behind the deepest house front
KERB = 0.14  # [m]
TILE = 5.0  # [m] of road with a texture of its own
BEHIND, AHEAD = 8.0, 24.0  # [m] of street before the first and after the last photo


def build_street(
    drive_length: float, *, seed: int, texels_per_m: float, course: CourseName = "winding"
) -> StreetBuilder:
    """The street for a drive of `drive_length` metres, closed by a house across its far end."""
    rng = np.random.default_rng([seed, 0])
    start, end = -BEHIND, drive_length + AHEAD
    line = Centerline(start - 20.0, end + 20.0, heading_of(course, drive_length, seed))
    street = StreetBuilder(line)
    paint = partial(_painter, rng, texels_per_m)

    vehicles = [(side, *spot) for side in (-1, 1) for spot in _parking(rng, end)]
    shadows = [(s, side * offset, length) for side, s, offset, length, _ in vehicles]
    _ground(street, rng, paint, start, end, shadows, texels_per_m)
    for side in (-1, 1):
        _houses(street, rng, paint, side, start, end)
    _closing_row(street, rng, paint, end)
    for side, s, offset, length, van in vehicles:
        _vehicle(street, rng, paint, s, side * offset, length, van)
    for side in (-1, 1):
        _furniture(street, rng, paint, side, end)
    return street


def _painter(rng: np.random.Generator, texels_per_m: float, texture, **options):
    """`texture` with a fresh seed at every call, as the (width, height) function that solids expect."""

    def paint(width: float, height: float) -> np.ndarray:
        own = np.random.default_rng(rng.integers(2**63))
        return texture(own, width, height, texels_per_m=texels_per_m, **options)

    return paint


def _ground(street, rng, paint, start, end, shadows, texels_per_m) -> None:
    edges = np.linspace(start, end, max(1, round((end - start) / TILE)) + 1)
    for near, far in itertools.pairwise(edges):
        under = [
            (offset - 0.95 + ROAD, far - s - length / 2 - 0.1, 1.9, length + 0.2)
            for s, offset, length in shadows
            if abs(s - (near + far) / 2) < TILE
        ]
        street.add_floor((near, far), (-ROAD, ROAD), 0.0, paint(surfaces.road, shadows=under))
        for left, right in ((-FOOTWAY, -ROAD), (ROAD, FOOTWAY)):
            street.add_floor((near, far), (left, right), KERB, paint(surfaces.pavement))
        street.add_wall((near, -ROAD), (far, -ROAD), 0.0, KERB, paint(surfaces.kerb))
        street.add_wall((far, ROAD), (near, ROAD), 0.0, KERB, paint(surfaces.kerb))


def _houses(street, rng, paint, side, start, end) -> None:
    near = start
    while near < end:
        far = min(near + rng.uniform(6.5, 11.0), end + 1.0)
        front = FRONT + rng.uniform(0.0, 1.5)
        height = rng.uniform(6.5, 12.5)
        left, right = (near, far) if side < 0 else (far, near)
        street.add_wall((left, side * front), (right, side * front), 0.0, height, paint(facades.facade))
        inner, outer = sorted((side * front, side * (front + 6.0)))
        street.add_wall((near, inner), (near, outer), 0.0, height, paint(facades.blank_wall))
        street.add_wall((far, outer), (far, inner), 0.0, height, paint(facades.blank_wall))
        if far - near > 3.0:
            _on_the_front(street, rng, paint, side, near, far, front, height)
        near = far


def _closing_row(street, rng, paint, end) -> None:
    """Three houses across the far end, the middle one set back: a single plane before all photos would mislead SfM."""
    edges = (-14.0, -3.5 + rng.uniform(-1, 1), 3.5 + rng.uniform(-1, 1), 14.0)
    back = (0.0, rng.uniform(3.0, 5.0), rng.uniform(0.5, 1.5))
    for (left, right), setback in zip(itertools.pairwise(edges), back, strict=True):
        s = end + setback
        street.add_wall((s, left), (s, right), 0.0, rng.uniform(9, 13), paint(facades.facade))
    for edge, before, behind in ((edges[1], back[0], back[1]), (edges[2], back[2], back[1])):
        near, far = (end + before, edge), (end + behind, edge)
        left, right = (far, near) if edge > 0 else (near, far)  # both look into the recess
        street.add_wall(left, right, 0.0, rng.uniform(9, 12), paint(facades.blank_wall))


def _on_the_front(street, rng, paint, side, near, far, front, height) -> None:
    """Balconies, awnings and hanging signs: things that stand out and so show parallax."""
    crate = paint(surfaces.crate)
    for _ in range(rng.integers(1, 4)):
        s = rng.uniform(near + 1.0, far - 1.0)
        kind = rng.integers(3)
        if kind == 0 and height > 7.5:
            size = (rng.uniform(1.4, 2.4), 0.9, 0.9)
            bottom = rng.choice(np.arange(3.2, height - 3.0, 3.0))
            street.add_box(s, side * (front - 0.45), size, bottom=bottom, side=crate, end=crate, roof=crate)
        elif kind == 1:
            size = (rng.uniform(1.6, 2.8), 0.8, 0.35)
            board = paint(facades.sign)
            street.add_box(s, side * (front - 0.4), size, bottom=2.6, side=board, end=crate, roof=crate)
        else:
            board = paint(facades.sign)
            size = (0.15, rng.uniform(0.7, 1.0), rng.uniform(0.7, 1.2))
            where = side * (front - 0.1 - size[1] / 2)
            street.add_box(s, where, size, bottom=rng.uniform(2.8, 3.8), side=crate, end=board, roof=crate)


def _parking(rng, end) -> list[tuple[float, float, float, bool]]:
    """(s, distance from the centreline, length, is a van) of the vehicles on one side."""
    spots = []
    s = rng.uniform(2.0, 5.0)
    while s < end - 8.0:
        van = rng.uniform() < 0.3
        length = rng.uniform(4.6, 5.2) if van else rng.uniform(3.7, 4.4)
        spots.append((s, rng.uniform(3.15, 3.35), length, van))
        s += length + rng.uniform(1.5, 7.0)
    return spots


def _vehicle(street, rng, paint, s, offset, length, van) -> None:
    color = random_color(rng, (0.2, 0.8), (0.35, 0.9))
    yaw = rng.uniform(-0.04, 0.04)
    side, end = paint(surfaces.vehicle_side, paint=color), paint(surfaces.vehicle_end, paint=color)
    glass = paint(surfaces.vehicle_cabin, paint=color)
    lid = paint(surfaces.crate) if van else paint(surfaces.vehicle_roof, paint=color)
    lower = 1.2 if van else 0.9
    street.add_box(s, offset, (length, 1.7, lower), bottom=0.04, yaw=yaw, side=side, end=end, roof=lid)
    cabin = (0.92 * length, 1.6, 0.95) if van else (0.55 * length, 1.5, 0.55)
    street.add_box(
        s, offset, cabin, bottom=0.04 + lower, yaw=yaw, taper=0.1 if van else 0.3, side=glass, end=glass, roof=lid
    )


def _furniture(street, rng, paint, side, end) -> None:
    """Trees, poles with signs, crates on the footway."""
    leaves, bark, crate = paint(surfaces.foliage), paint(surfaces.bark), paint(surfaces.crate)
    s = rng.uniform(3.0, 6.0)
    while s < end - 4.0:
        kind = rng.integers(3)
        if kind == 0:
            trunk, crown = rng.uniform(1.9, 2.5), rng.uniform(0.8, 1.2)
            where = side * rng.uniform(5.3, 5.8)
            street.add_prism(s, where, (0.16, 0.13), (KERB, trunk), 6, bark)
            street.add_prism(s, where, (0.7 * crown, crown), (trunk, trunk + 0.9), 8, leaves)
            street.add_prism(s, where, (crown, 0.35 * crown), (trunk + 0.9, trunk + 2.1), 8, leaves)
        elif kind == 1:
            where = side * rng.uniform(4.7, 5.0)
            street.add_prism(s, where, (0.09, 0.08), (KERB, 3.4), 6, bark)
            board = paint(facades.sign)
            size = (0.06, rng.uniform(0.6, 0.9), rng.uniform(0.6, 0.9))
            street.add_box(s, where, size, bottom=2.4, yaw=rng.uniform(-0.3, 0.3), side=crate, end=board, roof=crate)
        else:
            for _ in range(rng.integers(1, 4)):
                size = tuple(rng.uniform(0.5, 1.1, 3))
                spot = (s + rng.uniform(-0.9, 0.9), side * rng.uniform(5.2, 6.2))
                street.add_box(*spot, size, bottom=0.02, yaw=rng.uniform(-0.5, 0.5), side=crate, end=crate, roof=crate)
        s += rng.uniform(2.5, 5.5)
