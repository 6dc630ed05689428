"""A texture being painted: metres in, texels out, and the random ingredients every surface shares."""

import colorsys

import cv2
import numpy as np

# 3 x 5 dots, row by row: letters that look the same with every version of every library.
GLYPHS = {
    "A": ".#.#.#####.##.#",
    "B": "##.#.###.#.###.",
    "E": "####..##.#..###",
    "F": "####..##.#..#..",
    "H": "#.##.#####.##.#",
    "K": "#.##.###.#.##.#",
    "L": "#..#..#..#..###",
    "N": "##.#.##.##.##.#",
    "P": "##.#.###.#..#..",
    "R": "##.#.###.#.##.#",
    "S": ".###...#...###.",
    "T": "###.#..#..#..#.",
    "X": "#.##.#.#.#.##.#",
    "Z": "###..#.#.#..###",
    "1": ".#.##..#..#.###",
    "2": "##...#.#.#..###",
    "4": "#.##.####..#..#",
    "5": "####..##...###.",
    "7": "###..#.#..#..#.",
    "9": "####.####..#..#",
}


class Canvas:
    """An RGB float image addressed in metres from its top left corner."""

    def __init__(self, rng: np.random.Generator, width: float, height: float, *, texels_per_m: float, color):
        self.rng = rng
        self.width, self.height = width, height  # [m]
        self.density = texels_per_m
        shape = (max(4, round(height * texels_per_m)), max(4, round(width * texels_per_m)), 3)
        self.pixels = np.ones(shape, np.float32) * np.asarray(color, np.float32)

    def rect(self, x: float, y: float, width: float, height: float, color) -> None:
        """Filled, clipped to the canvas."""
        rows, cols = self._span(y, height, 0), self._span(x, width, 1)
        self.pixels[rows, cols] = color

    def tint(self, x: float, y: float, width: float, height: float, factor) -> None:
        """Multiply a rectangle's brightness."""
        rows, cols = self._span(y, height, 0), self._span(x, width, 1)
        self.pixels[rows, cols] *= np.asarray(factor, np.float32)

    def polygon(self, points, color) -> None:
        """Filled polygon, corners in metres."""
        corners = np.round(np.asarray(points) * self.density).astype(np.int32)
        cv2.fillPoly(self.pixels, [corners], tuple(map(float, color)))

    def ellipse(self, x: float, y: float, rx: float, ry: float, color) -> None:
        """Filled ellipse about (x, y)."""
        center = (round(x * self.density), round(y * self.density))
        axes = (max(1, round(rx * self.density)), max(1, round(ry * self.density)))
        cv2.ellipse(self.pixels, center, axes, 0, 0, 360, tuple(map(float, color)), -1)

    def line(self, points, width: float, color) -> None:
        """An open line through points in metres."""
        corners = np.round(np.asarray(points) * self.density).astype(np.int32)
        cv2.polylines(self.pixels, [corners], False, tuple(map(float, color)), max(1, round(width * self.density)))

    def text(self, string: str, x: float, y: float, height: float, color) -> None:
        """Block letters with their lower left corner at (x, y)."""
        dot = height / 5
        for k, letter in enumerate(string):
            for cell, ink in enumerate(GLYPHS[letter]):
                if ink == "#":
                    row, col = divmod(cell, 3)
                    self.rect(x + (4 * k + col) * dot, y - (5 - row) * dot, dot, dot, color)

    def bricks(self, x: float, y: float, width: float, height: float, *, brick: tuple[float, float], jitter: float):
        """Courses of bricks whose brightness varies by `jitter` (relative), with joints a little darker."""
        rows, cols = self._span(y, height, 0), self._span(x, width, 1)
        course = ((np.arange(rows.start, rows.stop) + 0.5) / self.density - y) / brick[1]
        along = ((np.arange(cols.start, cols.stop) + 0.5) / self.density - x) / brick[0]
        row, joint = np.maximum(course.astype(int), 0), (course % 1.0) * brick[1] < 0.03
        col = np.maximum((along + 0.5 * (row[:, None] % 2)).astype(int), 0)
        table = 1.0 + jitter * self.rng.uniform(-1, 1, (int(height / brick[1]) + 2, int(width / brick[0]) + 3))
        factor = table[row[:, None], col] * np.where(joint, 0.9, 1.0)[:, None]
        self.pixels[rows, cols] *= factor.astype(np.float32)[..., None]

    def stain(self, amount: float, *, size: float = 2.0, octaves: int = 4) -> None:
        """Irregular light and dark blotches, the largest about `size` metres: no two places look alike."""
        rows, cols = self.pixels.shape[:2]
        noise = np.zeros((rows, cols), np.float32)
        weight = 1.0
        for _ in range(octaves):
            grid = (max(2, round(self.width / size) + 2), max(2, round(self.height / size) + 2))
            coarse = self.rng.uniform(-1, 1, grid[::-1]).astype(np.float32)
            noise += weight * cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC)
            weight, size = 0.6 * weight, 0.5 * size
        self.pixels *= (1.0 + amount * noise)[..., None]

    def fade(self, top: float, bottom: float) -> None:
        """Multiply brightness by a ramp from `top` to `bottom`."""
        self.pixels *= np.linspace(top, bottom, len(self.pixels), dtype=np.float32)[:, None, None]

    def image(self) -> np.ndarray:
        """[H, W, 3] uint8 RGB."""
        return np.clip(self.pixels + 0.5, 0, 255).astype(np.uint8)

    def _span(self, start: float, length: float, axis: int) -> slice:
        size = self.pixels.shape[axis]
        low, high = round(start * self.density), round((start + length) * self.density)
        return slice(min(max(low, 0), size), min(max(high, 0), size))


def random_color(rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]) -> np.ndarray:
    """A colour of random hue with saturation and value in the given ranges, 0..255."""
    rgb = colorsys.hsv_to_rgb(rng.uniform(), rng.uniform(*saturation), rng.uniform(*value))
    return 255.0 * np.array(rgb, np.float32)


def masonry_color(rng: np.random.Generator) -> np.ndarray:
    """A colour that walls have: brick reds to sandstone yellows, a few greys and pale blues or greens."""
    earthy = rng.uniform() < 0.75
    hue = rng.uniform(0.01, 0.13) if earthy else rng.uniform(0.25, 0.65)
    saturation = rng.uniform(0.12, 0.5) if earthy else rng.uniform(0.05, 0.22)
    return 255.0 * np.array(colorsys.hsv_to_rgb(hue, saturation, rng.uniform(0.5, 0.85)), np.float32)


def random_word(rng: np.random.Generator, letters: int) -> str:
    return "".join(rng.choice(list(GLYPHS), letters))
