"""Compositing in the CPU's shape: float32, several threads, the same bits for any number of them (docs/kernels.md)."""

from dataclasses import dataclass

import warp as wp

from graphgs.kernels.launch import launch_range
from graphgs.kernels.rasterize.blocks import SUMS
from graphgs.kernels.rasterize.buffers import Frame, Image, Splats
from graphgs.kernels.rasterize.tile_lists import TileLists, list_tiles
from graphgs.kernels.rasterize.tiles_backward import gather_splat, unblend_tile
from graphgs.kernels.rasterize.tiles_forward import blend_tile

_CHUNKS_PER_THREAD = 16  # tiles differ widely in work


@dataclass(frozen=True)
class TilesState:
    """What the backward pass needs of the forward pass."""

    lists: TileLists
    alphas: wp.array  # [C * H * W]
    sums: wp.array  # [C * H * W] vec4
    block_masks: wp.array  # [I] int
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
    lists = list_tiles(splats, radii, frame, threads=threads)
    tiles = lists.tile_starts.size - 1
    sums = wp.empty(image.alphas.size, dtype=wp.vec4, device="cpu")
    block_masks = wp.empty(lists.ranks.size, dtype=int, device="cpu")
    tile_stops = wp.empty(tiles, dtype=int, device="cpu")
    launch_range(
        blend_tile,
        tiles,
        inputs=[lists.records, lists.ranks, lists.tile_starts, frame.width, frame.height, frame.backgrounds],
        outputs=[image.colors, image.alphas, image.depths, sums, block_masks, tile_stops],
        device="cpu",
        threads=threads,
        chunks_per_thread=_CHUNKS_PER_THREAD,
    )
    return TilesState(lists, image.alphas, sums, block_masks, tile_stops)


def composite_tiles_backward(
    splats: Splats, frame: Frame, state: TilesState, v_image: Image, v_splats: Splats, *, threads: int = 1
) -> None:
    """Fill `v_splats` where a splat was visible; the rest must be zero before."""
    lists = state.lists
    splat_sums = wp.zeros(lists.ranks.size * int(SUMS), dtype=float, device="cpu")
    launch_range(
        unblend_tile,
        state.tile_stops.size,
        inputs=[
            lists.records,
            lists.ranks,
            lists.slots,
            lists.tile_starts,
            state.tile_stops,
            state.block_masks,
            frame.width,
            frame.height,
            frame.backgrounds,
            state.alphas,
            state.sums,
            v_image.colors,
            v_image.alphas,
            v_image.depths,
        ],
        outputs=[splat_sums],
        device="cpu",
        threads=threads,
        chunks_per_thread=_CHUNKS_PER_THREAD,
    )
    launch_range(
        gather_splat,
        lists.splat_ids.size,
        inputs=[lists.splat_ids, lists.slot_starts, lists.records, splat_sums],
        outputs=[v_splats.means2d, v_splats.conics, v_splats.depths, v_splats.opacities, v_splats.colors],
        device="cpu",
        threads=threads,
        min_chunk=2048,
        chunks_per_thread=2,
    )
