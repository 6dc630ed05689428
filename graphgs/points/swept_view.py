"""One training photo at the size it is swept at, and the surfaces found in it."""

from dataclasses import dataclass

import cv2
import numpy as np

from graphgs.points.plane_sweep import WINDOW, PosedImage, sweep
from graphgs.scene.views import Views

AGREEING = 2  # partners that must find the same surface
TOLERANCE = 0.01  # of its depth


@dataclass(frozen=True)
class SmallView:
    """A training photo, reduced."""

    posed: PosedImage
    colors: np.ndarray  # [H, W, 3] uint8 RGB
    mask: np.ndarray | None  # [H, W] bool: what counts

    @staticmethod
    def read(views: Views, i: int, factor: float) -> "SmallView":
        """View i, its sides times `factor`."""
        image, mask = views.read(i)
        height, width = image.shape[:2]
        size = (max(1, round(factor * width)), max(1, round(factor * height)))
        colors = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        if mask is not None:  # a pixel counts where all of it does
            mask = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999
        K = np.diag([size[0] / width, size[1] / height, 1.0]) @ views.Ks[i]
        gray = cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY).astype(np.float32)
        return SmallView(PosedImage(gray, K, views.viewmats[i]), colors, mask)

    def swept(self, partners: list["SmallView"], depths: tuple[float, float]) -> "SweptView":
        """With the surfaces that look alike in the partners, between two depths (camera z)."""
        inverse = sweep(self.posed, [partner.posed for partner in partners], depths)
        if self.mask is not None:  # whole patches: the edge of what is masked looks alike in all photos
            whole = cv2.erode(self.mask.astype(np.uint8), np.ones((WINDOW, WINDOW), np.uint8)) > 0
            inverse = np.where(whole, inverse, np.float32(0.0))
        return SweptView(self, inverse)


@dataclass(frozen=True)
class SweptView:
    """A reduced photo with depths, as far as they are known."""

    photo: SmallView
    inverse: np.ndarray  # [H, W] 1 / camera z, 0 = not known

    def agreed(
        self,
        partners: list["SweptView"],
        *,
        most: int,  # points; more are thinned out at random
        seed: int,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(positions [P, 3] world, colors [P, 3], photos that agree [P]) of the pixels whose surface enough partners
        have found, too."""
        rows, columns = np.nonzero(self.inverse)
        posed = self.photo.posed
        pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
        in_camera = pixels @ np.linalg.inv(posed.K).T / self.inverse[rows, columns, None]
        world = (in_camera - posed.viewmat[:3, 3]) @ posed.viewmat[:3, :3]
        agreeing = sum((partner.finds(world).astype(int) for partner in partners), np.zeros(len(world), int))
        kept = np.flatnonzero(agreeing >= AGREEING)
        if len(kept) > most:
            kept = np.sort(np.random.default_rng(seed).choice(kept, most, replace=False))
        return world[kept], self.photo.colors[rows[kept], columns[kept]], agreeing[kept] + 1

    def finds(
        self,
        world: np.ndarray,  # [P, 3]
    ) -> np.ndarray:  # [P] bool
        """Whether a surface was found at these points."""
        posed = self.photo.posed
        in_camera = world @ posed.viewmat[:3, :3].T + posed.viewmat[:3, 3]
        depth = in_camera[:, 2]
        projected = in_camera @ posed.K.T
        columns, rows = np.floor(projected[:, :2] / np.maximum(projected[:, 2:], 1e-12)).T
        height, width = self.inverse.shape
        inside = (depth > 0) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        found = np.zeros(len(world))
        found[inside] = self.inverse[rows[inside].astype(int), columns[inside].astype(int)]
        return (found > 0) & (np.abs(found * depth - 1.0) < TOLERANCE)
