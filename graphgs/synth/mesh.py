"""Textured polygons gathered into the arrays the ray caster wants: triangles, affine texel maps, mip levels."""

import cv2
import numpy as np

from graphgs.kernels.raycast import TexturedScene

MIP_LEVELS = 8
SUN = np.array([0.45, -0.75, -0.5])  # direction towards the sun; the world's y points down
SUN /= np.linalg.norm(SUN)
AMBIENT = 0.72  # brightness of a face turned away from the sun


class MeshBuilder:
    """Collects planar polygons. Directions are as the viewer in front of a face sees them: u right, v down."""

    def __init__(self):
        self.vertices: list[np.ndarray] = []
        self.vertex_count = 0
        self.triangles: list[tuple[int, int, int]] = []
        self.texel_maps: list[np.ndarray] = []
        self.normals: list[np.ndarray] = []
        self.textures: list[int] = []
        self.images: list[np.ndarray] = []

    def add_quad(
        self,
        corners: np.ndarray,  # [4, 3] m; top left, top right, bottom right, bottom left
        texture: np.ndarray,  # [H, W, 3] uint8, stretched over the quad
    ) -> None:
        """A quad in front of which the viewer reads the texture the right way round."""
        height, width = texture.shape[:2]
        texels = np.array([[0, 0], [width, 0], [width, height], [0, height]], float)
        self.add_polygon(corners, texels, texture)

    def add_polygon(
        self,
        corners: np.ndarray,  # [n, 3] m, clockwise as seen from the front
        texels: np.ndarray,  # [n, 2] column and row of each corner
        texture: np.ndarray,  # [H, W, 3] uint8
    ) -> None:
        """A convex polygon, split into a fan; sunlight is multiplied into its texture."""
        normal = -np.cross(corners[1] - corners[0], corners[-1] - corners[0])
        normal /= np.linalg.norm(normal)
        light = AMBIENT + (1.0 - AMBIENT) * max(0.0, float(normal @ SUN))
        self.images.append(np.clip(texture.astype(np.float32) * light + 0.5, 0, 255).astype(np.uint8))
        base = self.vertex_count
        self.vertex_count += len(corners)
        self.vertices.append(np.asarray(corners, float))
        for k in range(1, len(corners) - 1):
            self.triangles.append((base, base + k, base + k + 1))
            self.texel_maps.append(_texel_map(corners[[0, k, k + 1]], texels[[0, k, k + 1]]))
            self.normals.append(normal)
            self.textures.append(len(self.images) - 1)

    def build(self, *, device) -> TexturedScene:
        """The scene on a device, with all mip levels."""
        offsets, sizes, texels, used = [], [], [], 0
        for image in self.images:
            level = image
            for _ in range(MIP_LEVELS):
                height, width = level.shape[:2]
                offsets.append(used)
                sizes.append((width, height))
                texels.append(level.reshape(-1, 3))
                used += width * height
                level = cv2.resize(level, (max(1, width // 2), max(1, height // 2)), interpolation=cv2.INTER_AREA)
        maps = np.array(self.texel_maps)
        count = len(self.images)
        return TexturedScene(
            vertices=np.concatenate(self.vertices).astype(np.float32),
            triangles=np.array(self.triangles, np.int32),
            texel_u=maps[:, 0].astype(np.float32),
            texel_v=maps[:, 1].astype(np.float32),
            normals=np.array(self.normals, np.float32),
            textures=np.array(self.textures, np.int32),
            mip_offsets=np.array(offsets, np.int32).reshape(count, MIP_LEVELS),
            mip_sizes=np.array(sizes, np.int32).reshape(count, MIP_LEVELS, 2),
            texels=np.concatenate(texels),
            device=device,
        )


def _texel_map(
    corners: np.ndarray,  # [3, 3] m
    texels: np.ndarray,  # [3, 2]
) -> np.ndarray:
    """[2, 4] affine map from a world point of the triangle's plane to its column and row; constant along the normal."""
    edges = corners[1:] - corners[0]
    gradient = (texels[1:] - texels[0]).T @ np.linalg.pinv(edges).T
    return np.hstack([gradient, (texels[0] - gradient @ corners[0])[:, None]])
