"""Boxes, prisms and upright walls placed along the centreline of a street."""

from collections.abc import Callable

import numpy as np

from graphgs.synth.drive import Centerline
from graphgs.synth.mesh import MeshBuilder

Paint = Callable[[float, float], np.ndarray]  # (width, height) in metres -> [H, W, 3] uint8


class StreetBuilder(MeshBuilder):
    """A mesh builder that speaks (s, offset, height): distance driven, metres right of the centreline, metres up."""

    def __init__(self, centerline: Centerline):
        super().__init__()
        self.line = centerline

    def add_wall(
        self,
        left: tuple[float, float],  # (s, offset) of the edge that a viewer in front sees on the left
        right: tuple[float, float],
        bottom: float,
        top: float,
        paint: Paint,
    ) -> None:
        """An upright quad."""
        corners = np.stack(
            [
                self.line.point(*left, top),
                self.line.point(*right, top),
                self.line.point(*right, bottom),
                self.line.point(*left, bottom),
            ]
        )
        self.add_quad(corners, paint(float(np.linalg.norm(corners[1] - corners[0])), top - bottom))

    def add_floor(self, s: tuple[float, float], offsets: tuple[float, float], height: float, paint: Paint) -> None:
        """A level quad between two distances and two offsets, seen from above with the driver's forward up."""
        (near, far), (left, right) = s, offsets
        corners = [(far, left), (far, right), (near, right), (near, left)]
        self.add_quad(
            np.stack([self.line.point(*corner, height) for corner in corners]), paint(right - left, far - near)
        )

    def add_box(
        self,
        s: float,
        offset: float,
        size: tuple[float, float, float],  # length along the street, width across, height
        *,
        bottom: float = 0.0,
        yaw: float = 0.0,
        taper: float = 0.0,  # [m] the roof is shorter by this at both ends
        side: Paint,
        end: Paint,
        roof: Paint,
    ) -> None:
        """A box standing at (s, offset); its underside is there when it floats."""
        length, width, height = size
        center, along, across = self._axes(s, offset, yaw)

        def corner(a: float, b: float, up: float) -> np.ndarray:
            a *= length / 2 - (taper if up else 0.0)
            return center + along * a + across * (b * width / 2) - [0.0, bottom + up * height, 0.0]

        def quad(a0, b0, a1, b1):  # upright, from its left edge to its right edge as seen from outside
            return np.stack([corner(a0, b0, 1), corner(a1, b1, 1), corner(a1, b1, 0), corner(a0, b0, 0)])

        self.add_quad(quad(-1, -1, -1, 1), end(width, height))
        self.add_quad(quad(1, 1, 1, -1), end(width, height))
        self.add_quad(quad(1, -1, -1, -1), np.ascontiguousarray(side(length, height)))
        self.add_quad(quad(-1, 1, 1, 1), side(length, height))
        top = [corner(1, -1, 1), corner(1, 1, 1), corner(-1, 1, 1), corner(-1, -1, 1)]
        self.add_quad(np.stack(top), roof(width, length - 2 * taper))
        if bottom > 0.05:
            underside = [corner(-1, -1, 0), corner(-1, 1, 0), corner(1, 1, 0), corner(1, -1, 0)]
            self.add_quad(np.stack(underside), roof(width, length))

    def add_prism(
        self,
        s: float,
        offset: float,
        radii: tuple[float, float],  # at the bottom and at the top
        heights: tuple[float, float],
        sides: int,
        paint: Paint,
    ) -> None:
        """An upright prism or a cut pyramid with both its caps."""
        center, along, across = self._axes(s, offset, 0.0)
        angles = 2 * np.pi * np.arange(sides) / sides
        ring = np.cos(angles)[:, None] * along + np.sin(angles)[:, None] * across
        low = center + radii[0] * ring - [0.0, heights[0], 0.0]
        high = center + radii[1] * ring - [0.0, heights[1], 0.0]
        strip = paint(2 * np.pi * max(radii), heights[1] - heights[0])
        edges = np.round(np.linspace(0, strip.shape[1], sides + 1)).astype(int)
        for k in range(sides):
            n = (k + 1) % sides  # ring runs from forward to the right: seen from outside, from right to left
            self.add_quad(np.stack([high[n], high[k], low[k], low[n]]), strip[:, edges[k] : edges[k + 1]])
        for cap, radius, order in ((high, radii[1], 1), (low, radii[0], -1)):
            image = paint(2 * radius, 2 * radius)
            flat = np.stack([1 + np.sin(angles), 1 - np.cos(angles)], axis=1) * (np.array(image.shape[1::-1]) / 2)
            self.add_polygon(cap[::order], flat[::order], image)

    def _axes(self, s: float, offset: float, yaw: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(ground point, unit vector along, unit vector to the right)."""
        heading = self.line.heading(s) + yaw
        along = np.array([np.sin(heading), 0.0, np.cos(heading)])
        across = np.array([np.cos(heading), 0.0, -np.sin(heading)])
        return self.line.point(s, offset, 0.0), along, across
