"""Open country seen from above: a height field with one painted texture.

World frame as in `graphgs.synth`: x right (east), y down, z forward (north), metres, the mean ground at y = 0.
"""

import cv2
import numpy as np

from graphgs.kernels.raycast import TexturedScene
from graphgs.synth.canvas import Canvas, random_color
from graphgs.synth.mesh import AMBIENT, SUN, MeshBuilder

TEXELS_PER_M = 12.0
STEP = 2.0  # [m] of the height field's grid
WAVES, WAVE_LENGTHS = 8, (60.0, 140.0)  # [m]


class Terrain:
    """Ground between -reach and +reach in x and z."""

    def __init__(
        self,
        reach: tuple[float, float],  # [m]
        *,
        relief: float,  # [m] between the lowest and the highest ground
        seed: int,
    ):
        self.reach = reach
        rng = np.random.default_rng([seed, 0])
        turns, lengths = rng.uniform(0, 2 * np.pi, WAVES), rng.uniform(*WAVE_LENGTHS, WAVES)
        self._waves = 2 * np.pi / lengths * np.stack([np.cos(turns), np.sin(turns)])  # [2, WAVES] rad per m
        self._phases = rng.uniform(0, 2 * np.pi, WAVES)
        self._gain, self._middle = 1.0, 0.0
        raw = self.height(*self._grid(STEP))
        self._gain, self._middle = relief / np.ptp(raw), (raw.min() + raw.max()) / 2
        self._rng = np.random.default_rng([seed, 1])

    def height(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """[...] m above y = 0."""
        waves = np.sin(x[..., None] * self._waves[0] + z[..., None] * self._waves[1] + self._phases)
        return self._gain * (waves.sum(-1) - self._middle)

    def build(self, *, device) -> TexturedScene:
        """The ground for the ray caster."""
        x, z = self._grid(STEP)
        vertices = np.stack([x, -self.height(x, z), z], axis=-1).reshape(-1, 3)
        index = np.arange(x.size).reshape(x.shape)
        corners = [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]]  # clockwise as seen from above
        a, b, c, d = (corner.ravel() for corner in corners)
        triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        normals = np.cross(vertices[triangles[:, 2]] - vertices[triangles[:, 0]],
                           vertices[triangles[:, 1]] - vertices[triangles[:, 0]])  # fmt: skip
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return _OneTexture(vertices, triangles, normals, self._texel_map(), self._painted()).build(device=device)

    def _grid(self, step: float) -> tuple[np.ndarray, np.ndarray]:
        """(x, z), both [rows from north to south, columns from west to east]."""
        (east, north) = self.reach
        columns, rows = np.arange(-east, east + step, step), np.arange(north, -north - step, -step)
        x, z = np.meshgrid(columns, rows)
        return x, z

    def _texel_map(self) -> np.ndarray:
        """[2, 4] column and row of a world point: the texture lies flat over the ground, north up."""
        east, north = self.reach
        return TEXELS_PER_M * np.array([[1.0, 0.0, 0.0, east], [0.0, 0.0, -1.0, north]])

    def _painted(self) -> np.ndarray:
        """[H, W, 3] uint8: fields, tracks, bushes and stones, soil that looks alike nowhere, lit by the sun."""
        rng, (east, north) = self._rng, self.reach
        land = Canvas(rng, 2 * east, 2 * north, texels_per_m=TEXELS_PER_M, color=(112, 118, 82))
        for _ in range(60):  # fields
            center, turn = rng.uniform(0, 1, 2) * [2 * east, 2 * north], rng.uniform(0, np.pi)
            half = rng.uniform(6.0, 22.0, 2)
            square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
            spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            land.polygon(center + square @ spin.T, random_color(rng, (0.15, 0.45), (0.35, 0.6)) * [0.9, 1.0, 0.6])
        for _ in range(10):  # tracks
            start = rng.uniform(0, 1, 2) * [2 * east, 2 * north]
            bends = np.cumsum(rng.normal(0, 8, (12, 2)) + rng.normal(0, 8, 2), axis=0)
            land.line(start + bends, rng.uniform(0.8, 2.5), (168, 156, 130))
        for _ in range(int(0.6 * 4 * east * north)):  # bushes, stones, molehills: one on 1.7 square metres
            x, y = rng.uniform(0, 2 * east), rng.uniform(0, 2 * north)
            size = 0.15 * np.exp(abs(rng.normal(0, 0.8)))
            color = random_color(rng, (0.0, 0.5), (0.2, 0.8))
            land.ellipse(x, y, size, size * rng.uniform(0.5, 1.0), 0.6 * color + 0.4 * np.array([80, 110, 60]))
        land.stain(0.12, size=16.0, octaves=8)
        land.pixels *= self._light(land.pixels.shape[:2])[..., None]
        return land.image()

    def _light(self, shape: tuple[int, int]) -> np.ndarray:
        """[H, W] float32 brightness of the slopes."""
        x, z = self._grid(STEP)
        south, east = np.gradient(self.height(x, z), STEP)  # rows run south
        normals = np.stack([-east, -np.ones_like(east), south], axis=-1)  # y points down
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        light = AMBIENT + (1.0 - AMBIENT) * np.maximum(normals @ SUN, 0.0)
        return cv2.resize(light.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)


class _OneTexture(MeshBuilder):
    """A mesh whose triangles share one texture."""

    def __init__(self, vertices, triangles, normals, texel_map, image):
        super().__init__()
        self.vertices, self.vertex_count = [vertices], len(vertices)
        self.triangles, self.normals = list(triangles), list(normals)
        self.texel_maps = [texel_map] * len(triangles)
        self.textures, self.images = [0] * len(triangles), [image]
