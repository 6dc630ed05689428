"""Compositing in the CPU's shape: float32, several threads, the same bits for any number of them (docs/kernels.md)."""

from dataclasses import dataclass

import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.rasterize.buffers import Frame, Image, Splats
from graphgs.kernels.rasterize.lanes import BATCH, BLOCKS
from graphgs.kernels.rasterize.tile_lists import TileLists, list_tiles
from graphgs.kernels.rasterize.tiles_backward import gather_splat_kernel, row_size, unblend_tile_kernel
from graphgs.kernels.rasterize.tiles_forward import blend_tile_kernel

_CHUNKS_PER_THREAD = 16  # tiles differ widely in work


@dataclass(frozen=True)
class TilesState:
    """What the backward pass needs of the forward pass."""

    lists: TileLists
    image: Image
    taken: wp.array  # [batches * BLOCKS] uint32
    tile_stops: wp.array  # [C * tiles] int


def composite_tiles(
    splats: Splats,
    radii: wp.array,  # [C * N] vec2i [px], 0 = not visible
    frame: Frame,
    image: Image,
    *,
    threads: int = 1,
) -> TilesState:
    """Fill `image`."""
    channels = splats.colors.dtype._length_
    lists = list_tiles(splats, radii, frame, threads=threads)
    tiles = lists.tile_starts.size - 1
    # A tile's batches begin at tile_starts[tile] // BATCH + tile: never where another tile's are.
    batches = lists.ranks.size // int(BATCH) + tiles
    taken = wp.empty(batches * int(BLOCKS), dtype=wp.uint32, device="cpu")
    tile_stops = wp.empty(tiles, dtype=int, device="cpu")
    launch_range(
        blend_tile_kernel(channels, image.median_depths is not None),
        tiles,
        inputs=[
            lists.records,
            lists.ranks,
            lists.tile_starts,
            frame.width,
            frame.height,
            frame.backgrounds,
            _or_empty(frame.masks, wp.uint8),
        ],
        outputs=[image.colors, image.alphas, image.depths, _or_empty(image.median_depths, float), taken, tile_stops],
        device="cpu",
        threads=threads,
        chunks_per_thread=_CHUNKS_PER_THREAD,
    )
    return TilesState(lists, image, taken, tile_stops)


def composite_tiles_backward(
    splats: Splats, frame: Frame, state: TilesState, v_image: Image, v_splats: Splats, *, threads: int = 1
) -> None:
    """Fill `v_splats` where a splat was visible; the rest must be zero before."""
    lists = state.lists
    channels = splats.colors.dtype._length_
    absolute = v_splats.abs_means2d is not None
    splat_sums = wp.empty(lists.ranks.size * row_size(channels, absolute), dtype=float, device="cpu")
    launch_range(
        unblend_tile_kernel(channels, v_image.median_depths is not None, absolute),
        state.tile_stops.size,
        inputs=[
            lists.records,
            lists.ranks,
            lists.slots,
            lists.tile_starts,
            state.tile_stops,
            state.taken,
            frame.width,
            frame.height,
            frame.backgrounds,
            state.image.colors,
            state.image.alphas,
            state.image.depths,
            v_image.colors,
            v_image.alphas,
            v_image.depths,
            _or_empty(v_image.median_depths, float),
        ],
        outputs=[splat_sums],
        device="cpu",
        threads=threads,
        chunks_per_thread=_CHUNKS_PER_THREAD,
    )
    launch_range(
        gather_splat_kernel(channels, absolute),
        lists.splat_ids.size,
        inputs=[lists.splat_ids, lists.slot_starts, lists.records, splat_sums, splats.opacities],
        outputs=[
            v_splats.means2d,
            v_splats.conics,
            v_splats.depths,
            v_splats.opacities,
            v_splats.colors,
            _or_empty(v_splats.abs_means2d, wp.vec2),
        ],
        device="cpu",
        threads=threads,
        min_chunk=2048,
        chunks_per_thread=2,
    )


def _or_empty(array: wp.array | None, dtype) -> wp.array:
    return wp.empty(0, dtype=dtype, device="cpu") if array is None else array
