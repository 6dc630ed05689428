"""Ground, vehicles, crates and foliage: textures painted from a seed."""

import cv2
import numpy as np

from graphgs.synth.canvas import Canvas, random_color, random_word


def road(
    rng: np.random.Generator,
    width: float,
    length: float,
    *,
    texels_per_m: float,
    shadows: list[tuple[float, float, float, float]],  # x, y, width, length in metres: under parked vehicles
) -> np.ndarray:
    """[H, W, 3] uint8 piece of road: asphalt with patches, lane dashes, manholes, cracks; drivers look up along it."""
    asphalt = Canvas(rng, width, length, texels_per_m=texels_per_m, color=(112, 112, 116))
    if rng.uniform() < 0.4:
        asphalt.bricks(0, 0, width, length, brick=(rng.uniform(0.25, 0.4), rng.uniform(0.18, 0.28)), jitter=0.16)
    asphalt.stain(0.16, size=2.5, octaves=6)
    for _ in range(rng.integers(2, 5)):  # repaired patches
        x, y = rng.uniform(0, width - 1), rng.uniform(0, length - 1)
        asphalt.tint(x, y, rng.uniform(0.5, 2.0), rng.uniform(0.5, 2.5), rng.uniform(0.72, 1.22))
    for _ in range(rng.integers(4, 8)):
        start = rng.uniform(0, 1, 2) * [width, length]
        asphalt.line(start + np.cumsum(rng.uniform(-0.5, 0.5, (5, 2)), axis=0), 0.05, (70, 70, 72))
    asphalt.rect(width / 2 - 0.08, length * 0.2, 0.16, length * 0.5, (205, 205, 195))
    for x in (0.12, width - 0.32):
        asphalt.rect(x, 0, 0.2, length, (140, 138, 130))
        asphalt.bricks(x, 0, 0.2, length, brick=(0.2, 0.3), jitter=0.2)
    if rng.uniform() < 0.7:
        x, y = rng.uniform(1, width - 1), rng.uniform(1, length - 1)
        asphalt.ellipse(x, y, 0.42, 0.42, (62, 60, 60))
        asphalt.ellipse(x, y, 0.34, 0.34, (95, 90, 86))
        for angle in rng.uniform(0, np.pi) + np.arange(3) * np.pi / 3:
            d = 0.3 * np.array([np.cos(angle), np.sin(angle)])
            asphalt.line([(x, y) - d, (x, y) + d], 0.06, (55, 52, 52))
    if rng.uniform() < 0.5:
        asphalt.text(random_word(rng, 2), rng.uniform(0.8, width - 2.0), rng.uniform(1.5, length), 0.9, (200, 198, 190))
    if shadows:
        shade = np.ones(asphalt.pixels.shape[:2], np.float32)
        for x, y, w, d in shadows:
            corners = np.array([(x, y), (x + w, y), (x + w, y + d), (x, y + d)]) * texels_per_m
            cv2.fillConvexPoly(shade, np.round(corners).astype(np.int32), 0.4)
        asphalt.pixels *= cv2.GaussianBlur(shade, (0, 0), 0.12 * texels_per_m)[..., None]
    return asphalt.image()


def pavement(rng: np.random.Generator, width: float, length: float, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 piece of footway: slabs or cobbles, drains, stains."""
    base = random_color(rng, (0.03, 0.15), (0.55, 0.68))
    slabs = Canvas(rng, width, length, texels_per_m=texels_per_m, color=base)
    size = (rng.uniform(0.25, 0.35), rng.uniform(0.2, 0.3)) if rng.uniform() < 0.4 else (0.7, 0.5)
    slabs.bricks(0, 0, width, length, brick=size, jitter=0.13)
    slabs.stain(0.12, size=1.5, octaves=5)
    for _ in range(rng.integers(1, 4)):
        x, y = rng.uniform(0, width - 0.6), rng.uniform(0, length - 0.6)
        slabs.rect(x, y, rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.6), random_color(rng, (0.0, 0.3), (0.25, 0.8)))
    return slabs.image()


def kerb(rng: np.random.Generator, length: float, height: float, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 kerb stones."""
    stones = Canvas(rng, length, height, texels_per_m=texels_per_m, color=(165, 162, 155))
    stones.bricks(0, 0, length, height, brick=(rng.uniform(0.6, 0.9), height), jitter=0.18)
    return stones.image()


def vehicle_side(rng: np.random.Generator, length: float, height: float, paint, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 lower body of a parked vehicle: doors, handles, lamps, wheels, a stripe."""
    body = Canvas(rng, length, height, texels_per_m=texels_per_m, color=paint)
    body.stain(0.08, size=0.8)
    body.rect(0, 0.28 * height, length, 0.06, np.asarray(paint) * rng.uniform(0.5, 1.3))
    for x in (0.3 * length, 0.52 * length, 0.72 * length):
        body.rect(x, 0.05, 0.03, 0.75 * height, np.asarray(paint) * 0.5)
        body.rect(x - 0.28, 0.2 * height, 0.18, 0.06, (40, 40, 40))
    body.rect(0, 0.82 * height, length, 0.18 * height, (45, 45, 48))
    for x in (0.2 * length, 0.8 * length):
        body.ellipse(x, 0.78 * height, 0.32, 0.32, (35, 35, 37))
        body.ellipse(x, 0.78 * height, 0.18, 0.18, (170, 172, 176))
        body.ellipse(x, 0.78 * height, 0.07, 0.07, (80, 80, 84))
    body.rect(0, 0.2 * height, 0.25, 0.2, (220, 60, 40))
    body.rect(length - 0.25, 0.2 * height, 0.25, 0.2, (240, 235, 200))
    if rng.uniform() < 0.4:
        body.text(random_word(rng, 4), 0.36 * length, 0.68 * height, 0.28, 255.0 - np.asarray(paint))
    return body.image()


def vehicle_end(rng: np.random.Generator, width: float, height: float, paint, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 front or rear: lamps, bumper, number plate."""
    end = Canvas(rng, width, height, texels_per_m=texels_per_m, color=paint)
    end.stain(0.05, size=0.8)
    lamp = (225, 50, 40) if rng.uniform() < 0.5 else (245, 240, 210)
    for x in (0.05 * width, 0.75 * width):
        end.rect(x, 0.15 * height, 0.2 * width, 0.22 * height, lamp)
    end.rect(0.3 * width, 0.12 * height, 0.4 * width, 0.25 * height, np.asarray(paint) * 0.45)
    end.rect(0, 0.7 * height, width, 0.3 * height, (50, 50, 53))
    end.rect(0.33 * width, 0.48 * height, 0.34 * width, 0.18 * height, (240, 240, 235))
    end.text(random_word(rng, 5), 0.35 * width, 0.64 * height, 0.07 * width, (25, 25, 70))
    return end.image()


def vehicle_cabin(rng: np.random.Generator, width: float, height: float, paint, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 windows of a vehicle with their frames and a reflection."""
    cabin = Canvas(rng, width, height, texels_per_m=texels_per_m, color=paint)
    panes = max(1, round(width / 1.1))
    for k in range(panes):
        x = (k + 0.08) * width / panes
        glass = random_color(rng, (0.1, 0.3), (0.18, 0.35))
        cabin.rect(x, 0.14 * height, 0.84 * width / panes, 0.7 * height, glass)
        lean = rng.uniform(0.1, 0.5) * width / panes
        top, bottom = 0.14 * height, 0.84 * height
        cabin.polygon(
            [(x + lean, top), (x + lean + 0.2, top), (x + lean, bottom), (x + lean - 0.2, bottom)], 1.8 * glass
        )
    return cabin.image()


def crate(rng: np.random.Generator, width: float, height: float, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 side of a crate or bin: planks, a label, a stencil."""
    color = random_color(rng, (0.25, 0.7), (0.4, 0.75))
    side = Canvas(rng, width, height, texels_per_m=texels_per_m, color=color)
    side.bricks(0, 0, width, height, brick=(width, max(0.12, height / 6)), jitter=0.18)
    side.stain(0.10, size=0.6)
    label = random_color(rng, (0.1, 0.8), (0.7, 0.95))
    x, y = rng.uniform(0.05, 0.4) * width, rng.uniform(0.1, 0.4) * height
    side.rect(x, y, 0.5 * width, 0.4 * height, label)
    side.text(random_word(rng, 2), x + 0.06 * width, y + 0.35 * height, min(0.28 * height, 0.25 * width), 255.0 - label)
    side.rect(0, 0, width, 0.05, color * 0.6)
    side.rect(0, height - 0.05, width, 0.05, color * 0.6)
    return side.image()


def bark(rng: np.random.Generator, width: float, height: float, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 trunk or pole with rings, bills and stains."""
    trunk = Canvas(rng, width, height, texels_per_m=texels_per_m, color=random_color(rng, (0.1, 0.35), (0.35, 0.5)))
    trunk.stain(0.2, size=0.4)
    for _ in range(max(2, int(height))):
        y = rng.uniform(0, height)
        trunk.rect(0, y, width, rng.uniform(0.05, 0.3), random_color(rng, (0.0, 0.7), (0.3, 0.9)))
    return trunk.image()


def foliage(rng: np.random.Generator, width: float, height: float, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 leaves: overlapping blobs of green."""
    leaves = Canvas(rng, width, height, texels_per_m=texels_per_m, color=(62, 92, 44))
    for _ in range(int(30 * width * height)):
        green = np.array([70, 120, 50]) * rng.uniform(0.55, 1.5) + [rng.uniform(-10, 40), 0, rng.uniform(-10, 10)]
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        leaves.ellipse(x, y, rng.uniform(0.06, 0.22), rng.uniform(0.05, 0.18), green)
    leaves.stain(0.12, size=1.0)
    return leaves.image()


def vehicle_roof(rng: np.random.Generator, width: float, height: float, paint, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 sheet metal seen from above, with seams and dirt."""
    sheet = Canvas(rng, width, height, texels_per_m=texels_per_m, color=paint)
    sheet.stain(0.07, size=0.7)
    sheet.rect(0.08 * width, 0, 0.03, height, np.asarray(paint) * 0.6)
    sheet.rect(0.92 * width, 0, 0.03, height, np.asarray(paint) * 0.6)
    return sheet.image()
