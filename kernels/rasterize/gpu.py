"""Compositing in the GPU's shape: float32, a block of 256 threads per 16 x 16 tile (docs/kernels.md).

It runs on CUDA, and on the CPU with `wp.config.enable_cpu_blocks`, which is how its tests run without a GPU. Sums are
added in a fixed order, without atomics, so a device gives the same bits every time.
"""

from dataclasses import dataclass

import warp as wp

from graphgs.kernels.launch import launch, launch_blocks
from graphgs.kernels.rasterize.buffers import Frame, Image, Splats, or_empty
from graphgs.kernels.rasterize.gpu_backward import gpu_backward_kernel, row_size
from graphgs.kernels.rasterize.gpu_forward import gpu_forward_kernel
from graphgs.kernels.rasterize.gpu_gather import SHARERS, gather_splats_kernel
from graphgs.kernels.rasterize.gpu_lists import GpuLists, list_tiles
from graphgs.kernels.rasterize.gpu_room import IntersectionOverflow, Room, shared_room

__all__ = ["GpuState", "IntersectionOverflow", "composite_gpu", "composite_gpu_backward"]


@dataclass(frozen=True)
class GpuState:
    """What the backward pass needs of the forward pass."""

    lists: GpuLists
    room: Room
    alphas: wp.array  # [C * H * W]
    depths: wp.array  # [C * H * W]
    color_sums: wp.array  # [C * H * W] vector of D channels
    tile_stops: wp.array  # [C * tiles] int


def composite_gpu(
    splats: Splats,
    radii: wp.array,  # [C * N] vec2i [px], 0 = not visible
    frame: Frame,
    image: Image,
    *,
    threads: int = 1,  # the CPU's; as in the other shapes
    exact: bool = False,  # wait for the count of intersections: for callers that will not call the backward pass
    room: Room | None = None,  # None: the one of the device's current stream
) -> GpuState:
    """Fill `image`. Unless `exact`, whether it is whole is known in the backward pass (see `gpu_room`)."""
    device = splats.depths.device
    room = shared_room(device) if room is None else room
    lists = list_tiles(splats, radii, frame, room, exact=exact)
    pixels, tiles = image.alphas.size, lists.tile_ranges.size
    color_sums, tile_stops = room.lend("pixels", (image.colors.dtype, pixels), (int, tiles))
    launch_blocks(
        gpu_forward_kernel(splats.colors.dtype._length_),
        lists.tile_ranges.size,
        inputs=[
            splats.means2d,
            splats.conics,
            splats.depths,
            splats.opacities,
            splats.colors,
            lists.splat_ids,
            lists.tile_ranges,
            frame.width,
            frame.height,
            frame.backgrounds,
            or_empty(frame.masks, wp.uint8, device),
        ],
        outputs=[
            image.colors,
            image.alphas,
            image.depths,
            or_empty(image.median_depths, float, device),
            color_sums,
            tile_stops,
        ],
        device=device,
    )
    return GpuState(lists, room, image.alphas, image.depths, color_sums, tile_stops)


def composite_gpu_backward(
    splats: Splats, frame: Frame, state: GpuState, v_image: Image, v_splats: Splats, *, threads: int = 1
) -> None:
    """Fill `v_splats`. Raises IntersectionOverflow."""
    device = splats.depths.device
    lists, room = state.lists, state.room
    if lists.count is not None:
        room.check(lists.count)
    channels = splats.colors.dtype._length_
    absolute = v_splats.abs_means2d is not None
    splat_sums = room.scratch("splat_sums", lists.slots.size * row_size(channels, absolute), float)
    launch_blocks(
        gpu_backward_kernel(channels, absolute),
        state.tile_stops.size,
        inputs=[
            splats.means2d,
            splats.conics,
            splats.depths,
            splats.opacities,
            splats.colors,
            lists.splat_ids,
            lists.slots,
            lists.tile_ranges,
            state.tile_stops,
            frame.width,
            frame.height,
            frame.backgrounds,
            state.alphas,
            state.depths,
            state.color_sums,
            v_image.colors,
            or_empty(v_image.alphas, float, device),
            or_empty(v_image.depths, float, device),
            or_empty(v_image.median_depths, float, device),
        ],
        outputs=[splat_sums],
        device=device,
    )
    launch(
        gather_splats_kernel(channels, absolute),
        splats.depths.size * int(SHARERS),
        inputs=[lists.order, lists.slot_ends, splats.conics, splats.opacities, splat_sums],
        outputs=[
            v_splats.means2d,
            v_splats.conics,
            v_splats.depths,
            v_splats.opacities,
            v_splats.colors,
            or_empty(v_splats.abs_means2d, wp.vec2, device),
        ],
        device=device,
    )
