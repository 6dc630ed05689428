"""Photographs of a textured triangle mesh: rays through a BVH, mip-mapped textures, a sky with clouds.

Colours are display values (gamma encoded) in 0..255. Textures are filtered along the long axis of a pixel's footprint,
so a facade seen at a grazing angle neither shimmers nor blurs.
"""

import numpy as np
import warp as wp

from graphgs.kernels.launch import launch_range

# Images have no gradient here.
wp.set_module_options({"enable_backward": False})

MAX_TAPS = 12  # texture samples along the footprint's long axis
FAR = wp.constant(1.0e6)


class TexturedScene:
    """Triangles with textures on one device. Texel coordinates are affine in the world, per triangle."""

    def __init__(
        self,
        vertices: np.ndarray,  # [V, 3] world
        triangles: np.ndarray,  # [F, 3] int
        texel_u: np.ndarray,  # [F, 4] column of a world point: texel_u . (x, y, z, 1)
        texel_v: np.ndarray,  # [F, 4] row
        normals: np.ndarray,  # [F, 3] unit
        textures: np.ndarray,  # [F] int
        mip_offsets: np.ndarray,  # [T, L] first texel of a level
        mip_sizes: np.ndarray,  # [T, L, 2] width and height
        texels: np.ndarray,  # [M, 3] uint8 RGB, all textures, all levels, row by row
        *,
        device,
    ):
        self.device = wp.get_device(device)
        self.mesh = wp.Mesh(
            points=wp.array(vertices, dtype=wp.vec3, device=device),
            indices=wp.array(np.ascontiguousarray(triangles, np.int32).ravel(), dtype=int, device=device),
        )
        self.texel_u = wp.array(texel_u, dtype=wp.vec4, device=device)
        self.texel_v = wp.array(texel_v, dtype=wp.vec4, device=device)
        self.normals = wp.array(normals, dtype=wp.vec3, device=device)
        self.textures = wp.array(textures, dtype=int, device=device)
        self.levels = int(mip_offsets.shape[1])
        self.mip_offsets = wp.array(mip_offsets.ravel(), dtype=int, device=device)
        self.mip_sizes = wp.array(mip_sizes.reshape(-1, 2), dtype=wp.vec2i, device=device)
        self.texels = wp.array(texels, dtype=wp.vec3ub, device=device)


@wp.func
def texel(
    texels: wp.array[wp.vec3ub],
    offset: int,
    size: wp.vec2i,
    x: int,
    y: int,
):
    c = texels[offset + wp.clamp(y, 0, size[1] - 1) * size[0] + wp.clamp(x, 0, size[0] - 1)]
    return wp.vec3(float(c[0]), float(c[1]), float(c[2]))


@wp.func
def sample_level(
    mip_offsets: wp.array[int],
    mip_sizes: wp.array[wp.vec2i],
    texels: wp.array[wp.vec3ub],
    base: int,  # index of the texture's level 0
    level: int,
    u: float,  # texels of level 0
    v: float,
):
    """Bilinear sample of one mip level; texel centres lie at +0.5, edges are clamped."""
    size = mip_sizes[base + level]
    full = mip_sizes[base]
    x = u * float(size[0]) / float(full[0]) - 0.5
    y = v * float(size[1]) / float(full[1]) - 0.5
    x0 = wp.floor(x)
    y0 = wp.floor(y)
    fx = x - x0
    fy = y - y0
    offset = mip_offsets[base + level]
    ix = int(x0)
    iy = int(y0)
    top = texel(texels, offset, size, ix, iy) * (1.0 - fx) + texel(texels, offset, size, ix + 1, iy) * fx
    bottom = texel(texels, offset, size, ix, iy + 1) * (1.0 - fx) + texel(texels, offset, size, ix + 1, iy + 1) * fx
    return top * (1.0 - fy) + bottom * fy


@wp.func
def sky(direction: wp.vec3, seed: wp.uint32):
    """Blue gradient with soft clouds; the world's y points down."""
    up = -direction[1]
    clear = wp.lerp(wp.vec3(206.0, 220.0, 234.0), wp.vec3(92.0, 142.0, 205.0), wp.clamp(up * 1.6, 0.0, 1.0))
    p = direction * 3.0
    cloud = wp.noise(seed, p) + 0.5 * wp.noise(seed, 2.1 * p) + 0.25 * wp.noise(seed, 4.3 * p)
    return wp.lerp(clear, wp.vec3(240.0, 241.0, 243.0), 0.9 * wp.smoothstep(-0.15, 0.6, cloud))


@wp.func
def pixel_ray(
    x: float,  # [px]
    y: float,
    focal: wp.vec2,
    principal: wp.vec2,
):
    """Ray through an image position, camera frame, z = 1."""
    return wp.vec3((x - principal[0]) / focal[0], (y - principal[1]) / focal[1], 1.0)


@wp.func
def surface_color(
    # Scene
    texel_u: wp.array[wp.vec4],
    texel_v: wp.array[wp.vec4],
    normals: wp.array[wp.vec3],
    textures: wp.array[int],
    levels: int,
    mip_offsets: wp.array[int],
    mip_sizes: wp.array[wp.vec2i],
    texels: wp.array[wp.vec3ub],
    # Ray
    face: int,
    point: wp.vec3,
    ray: wp.vec3,  # unit
    across: float,  # [world] width of the ray's cone at the point
):
    """Texture averaged over the cone's elliptic footprint: taps along its long axis, each as wide as its short one."""
    normal = normals[face]
    slant = wp.max(wp.abs(wp.dot(ray, normal)), 0.02)
    taps = wp.clamp(int(1.0 / slant + 0.5), 1, MAX_TAPS)
    spacing = across / (slant * float(taps))
    along = ray - normal * wp.dot(ray, normal)
    length = wp.length(along)
    along = wp.where(length > 1.0e-6, along / length, wp.vec3(0.0))
    gu = texel_u[face]
    gv = texel_v[face]
    density = wp.max(wp.length(wp.vec3(gu[0], gu[1], gu[2])), wp.length(wp.vec3(gv[0], gv[1], gv[2])))
    lod = wp.clamp(wp.log2(wp.max(wp.max(spacing, across) * density, 1.0)), 0.0, float(levels) - 1.001)
    level = int(lod)
    blend = lod - float(level)
    base = textures[face] * levels
    color = wp.vec3(0.0)
    for tap in range(taps):
        p = point + along * ((float(tap) + 0.5 - 0.5 * float(taps)) * spacing)
        h = wp.vec4(p[0], p[1], p[2], 1.0)
        u = wp.dot(gu, h)
        v = wp.dot(gv, h)
        sharp = sample_level(mip_offsets, mip_sizes, texels, base, level, u, v)
        soft = sample_level(mip_offsets, mip_sizes, texels, base, level + 1, u, v)
        color += wp.lerp(sharp, soft, blend)
    return color / float(taps)


@wp.kernel
def cast_centers(
    first: int,
    # Scene
    mesh: wp.uint64,
    # Camera
    center: wp.vec3,
    world_from_cam: wp.mat33,
    focal: wp.vec2,
    principal: wp.vec2,
    width: int,
    # Out
    faces: wp.array[int],
    depths: wp.array[float],
):
    """A thread owns a pixel: the face its centre sees (-1 = sky) and that point's depth."""
    pixel = first + wp.tid()
    axis = pixel_ray(float(pixel % width) + 0.5, float(pixel // width) + 0.5, focal, principal)
    hit = wp.mesh_query_ray(mesh, center, wp.normalize(world_from_cam * axis), FAR)
    faces[pixel] = wp.where(hit.result, hit.face, -1)
    depths[pixel] = wp.where(hit.result, hit.t / wp.length(axis), 0.0)


@wp.func
def borders(
    textures: wp.array[int],
    faces: wp.array[int],
    px: int,
    py: int,
    width: int,
    height: int,
):
    """Whether one of the eight neighbours sees another texture than the pixel does, or one of both sees the sky."""
    face = faces[py * width + px]
    for k in range(9):
        column = wp.clamp(px + k % 3 - 1, 0, width - 1)
        row = wp.clamp(py + k // 3 - 1, 0, height - 1)
        other = faces[row * width + column]
        if (other < 0) != (face < 0):
            return True
        if face >= 0 and textures[wp.max(other, 0)] != textures[face]:
            return True
    return False


@wp.kernel
def shade_pixels(
    first: int,
    # Scene
    mesh: wp.uint64,
    texel_u: wp.array[wp.vec4],
    texel_v: wp.array[wp.vec4],
    normals: wp.array[wp.vec3],
    textures: wp.array[int],
    levels: int,
    mip_offsets: wp.array[int],
    mip_sizes: wp.array[wp.vec2i],
    texels: wp.array[wp.vec3ub],
    sky_seed: wp.uint32,
    # Camera
    center: wp.vec3,
    world_from_cam: wp.mat33,
    focal: wp.vec2,
    principal: wp.vec2,
    width: int,
    height: int,
    # Visible
    faces: wp.array[int],
    depths: wp.array[float],
    # Sampling
    samples: int,
    gain: float,
    # Out
    colors: wp.array[wp.vec3ub],
):
    """A thread owns a pixel. Inside a texture its filter is enough; where a neighbour sees another texture, or the sky,
    samples x samples rays are averaged."""
    pixel = first + wp.tid()
    px = pixel % width
    py = pixel // width
    face = faces[pixel]
    pitch = 1.0 / wp.min(focal[0], focal[1])

    color = wp.vec3(0.0)
    if borders(textures, faces, px, py, width, height):
        for k in range(samples * samples):
            x = float(px) + (float(k % samples) + 0.5) / float(samples)
            y = float(py) + (float(k // samples) + 0.5) / float(samples)
            ray = wp.normalize(world_from_cam * pixel_ray(x, y, focal, principal))
            hit = wp.mesh_query_ray(mesh, center, ray, FAR)
            if hit.result:
                color += surface_color(
                    texel_u, texel_v, normals, textures, levels, mip_offsets, mip_sizes, texels,
                    hit.face, center + ray * hit.t, ray, hit.t * pitch / float(samples),
                )  # fmt: skip
            else:
                color += sky(ray, sky_seed)
        color = color / float(samples * samples)
    else:
        axis = pixel_ray(float(px) + 0.5, float(py) + 0.5, focal, principal)
        far = depths[pixel] * wp.length(axis)
        ray = wp.normalize(world_from_cam * axis)
        if face >= 0:
            color = surface_color(
                texel_u, texel_v, normals, textures, levels, mip_offsets, mip_sizes, texels,
                face, center + ray * far, ray, far * pitch,
            )  # fmt: skip
        else:
            color = sky(ray, sky_seed)
    color = color * gain
    colors[pixel] = wp.vec3ub(
        wp.uint8(wp.clamp(color[0] + 0.5, 0.0, 255.0)),
        wp.uint8(wp.clamp(color[1] + 0.5, 0.0, 255.0)),
        wp.uint8(wp.clamp(color[2] + 0.5, 0.0, 255.0)),
    )


def raycast(
    scene: TexturedScene,
    viewmat: np.ndarray,  # [4, 4] world-to-camera
    K: np.ndarray,  # [3, 3] px
    width: int,
    height: int,
    *,
    samples: int = 3,  # rays per pixel and axis where surfaces meet
    gain: float = 1.0,  # factor on the display values
    sky_seed: int = 0,
    threads: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """(colours [H, W, 3] uint8 RGB, depths [H, W] float32 at the pixel centres, camera z, 0 = sky)."""
    faces = wp.empty(width * height, dtype=int, device=scene.device)
    depths = wp.empty(width * height, dtype=float, device=scene.device)
    colors = wp.empty(width * height, dtype=wp.vec3ub, device=scene.device)
    world_from_cam = viewmat[:3, :3].T
    camera = [
        wp.vec3(*(-world_from_cam @ viewmat[:3, 3])),
        wp.mat33(*world_from_cam.ravel()),
        wp.vec2(K[0, 0], K[1, 1]),
        wp.vec2(K[0, 2], K[1, 2]),
        width,
    ]
    surfaces = [
        scene.texel_u,
        scene.texel_v,
        scene.normals,
        scene.textures,
        scene.levels,
        scene.mip_offsets,
        scene.mip_sizes,
        scene.texels,
    ]
    launch_range(
        cast_centers,
        width * height,
        inputs=[scene.mesh.id, *camera],
        outputs=[faces, depths],
        device=scene.device,
        threads=threads,
    )
    launch_range(
        shade_pixels,
        width * height,
        inputs=[
            scene.mesh.id,
            *surfaces,
            wp.uint32(sky_seed),
            *camera,
            height,
            faces,
            depths,
            samples,
            gain,
        ],
        outputs=[colors],
        device=scene.device,
        threads=threads,
    )
    return colors.numpy().reshape(height, width, 3), depths.numpy().reshape(height, width)
