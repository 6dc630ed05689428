"""Which splats meet which tile, front to back: the CPU's form.

Depth is sorted once per camera; a counting sort by tile, which keeps that order, does the rest. Several threads count
and fill at once, each a range of splats, so the lists do not depend on their number. A tile is listed only if the
ellipse where alpha >= ALPHA_MIN covers one of its pixel centres' rows and columns.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from graphgs.kernels.cpu_flags import VECTOR_OPTIONS
from graphgs.kernels.launch import launch_range
from graphgs.kernels.rasterize.buffers import Frame, Splats
from graphgs.kernels.rasterize.constants import TILE_SIZE
from graphgs.kernels.rasterize.ellipse import Ellipse, alpha_ellipse, band_extent, cells_between
from graphgs.kernels.rasterize.lanes import COLORS, DEPTH, ELLIPSE, LOG2_OPACITY, record_size

wp.set_module_options(VECTOR_OPTIONS)

_CHUNKS_PER_THREAD = 4


@dataclass(frozen=True)
class TileLists:
    """Splats are named by rank: camera by camera, front to back."""

    splat_ids: wp.array  # [M] int: camera * N + Gaussian, by rank
    records: wp.array  # [M * record_size] float: what compositing reads of a splat
    ranks: wp.array  # [I] int, tile by tile, front to back
    slots: wp.array  # [I] int: the same intersections counted splat by splat, where a gradient is written
    tile_starts: wp.array  # [C * tiles + 1] int, into `ranks`
    slot_starts: wp.array  # [M + 1] int, into slots


@wp.func
def record_ellipse(records: wp.array[float], at: int):
    ellipse = Ellipse()
    ellipse.slope = records[at + ELLIPSE]
    ellipse.height = records[at + ELLIPSE + 1]
    ellipse.right_y = records[at + ELLIPSE + 2]
    ellipse.flatness = records[at + ELLIPSE + 3]
    ellipse.width = records[at + ELLIPSE + 4]
    return ellipse


@cache
def pack_records_kernel(channels: int):
    vec = wp.types.vector(channels, wp.float32)
    size = record_size(channels)

    @wp.kernel(enable_backward=False, module="unique", module_options=VECTOR_OPTIONS)
    def pack_records(
        first: int,
        # Splats
        splat_ids: wp.array[int],  # [M]
        means2d: wp.array[wp.vec2],  # [C * N]
        conics: wp.array[wp.vec3],
        depths: wp.array[float],
        opacities: wp.array[float],
        colors: wp.array(dtype=vec),
        # Out
        records: wp.array[float],  # [M * size]
    ):
        rank = first + wp.tid()
        s = splat_ids[rank]
        at = rank * size
        records[at] = means2d[s][0]
        records[at + 1] = means2d[s][1]
        for k in range(3):
            records[at + 2 + k] = conics[s][k]
        for k in range(channels):
            records[at + COLORS + k] = colors[s][k]
        records[at + LOG2_OPACITY] = wp.log2(opacities[s])
        records[at + DEPTH] = depths[s]
        ellipse = alpha_ellipse(conics[s], opacities[s])
        records[at + ELLIPSE] = ellipse.slope
        records[at + ELLIPSE + 1] = ellipse.height
        records[at + ELLIPSE + 2] = ellipse.right_y
        records[at + ELLIPSE + 3] = ellipse.flatness
        records[at + ELLIPSE + 4] = ellipse.width

    return pack_records


@wp.func
def tile_row_span(records: wp.array[float], at: int, rows: int):
    """First and last row of tiles that the ellipse meets; first > last where it meets none."""
    my = records[at + 1]
    height = records[at + ELLIPSE + 1]
    return cells_between(my - height, my + height, float(TILE_SIZE), rows)


@wp.func
def tile_column_span(records: wp.array[float], at: int, row: int, columns: int):
    """First and last tile of that row."""
    mx = records[at]
    top = float(row * TILE_SIZE) + 0.5 - records[at + 1]
    left, right = band_extent(record_ellipse(records, at), top, top + float(TILE_SIZE - 1))
    return cells_between(mx + left, mx + right, float(TILE_SIZE), columns)


@wp.kernel
def count_chunk(
    first: int,
    records: wp.array[float],  # [M * record_size]
    splat_ids: wp.array[int],  # [M]
    splats: int,  # per camera
    record_size: int,  # floats
    chunk_size: int,  # ranks
    rows: int,
    columns: int,
    # Out
    tile_counts: wp.array2d[int],  # [chunks, C * tiles], zero before
    slot_counts: wp.array[int],  # [M] tiles of each splat
):
    chunk = first + wp.tid()
    for rank in range(chunk * chunk_size, wp.min((chunk + 1) * chunk_size, splat_ids.shape[0])):
        at = rank * record_size
        base = (splat_ids[rank] // splats) * rows * columns
        count = int(0)
        first_row, last_row = tile_row_span(records, at, rows)
        for row in range(first_row, last_row + 1):
            first_column, last_column = tile_column_span(records, at, row, columns)
            for column in range(first_column, last_column + 1):
                tile = base + row * columns + column
                tile_counts[chunk, tile] = tile_counts[chunk, tile] + 1
                count += 1
        slot_counts[rank] = count


@wp.kernel
def fill_chunk(
    first: int,
    records: wp.array[float],  # [M * record_size]
    splat_ids: wp.array[int],  # [M]
    slot_starts: wp.array[int],  # [M + 1]
    splats: int,  # per camera
    record_size: int,  # floats
    chunk_size: int,  # ranks
    rows: int,
    columns: int,
    # Out
    cursors: wp.array2d[int],  # [chunks, C * tiles]: where the chunk's next splat of a tile goes; moves on
    ranks: wp.array[int],  # [I]
    slots: wp.array[int],  # [I]
):
    chunk = first + wp.tid()
    for rank in range(chunk * chunk_size, wp.min((chunk + 1) * chunk_size, splat_ids.shape[0])):
        at = rank * record_size
        base = (splat_ids[rank] // splats) * rows * columns
        slot = int(slot_starts[rank])
        first_row, last_row = tile_row_span(records, at, rows)
        for row in range(first_row, last_row + 1):
            first_column, last_column = tile_column_span(records, at, row, columns)
            for column in range(first_column, last_column + 1):
                tile = base + row * columns + column
                i = cursors[chunk, tile]
                cursors[chunk, tile] = i + 1
                ranks[i] = rank
                slots[i] = slot
                slot += 1


def list_tiles(splats: Splats, radii: wp.array, frame: Frame, *, threads: int = 1) -> TileLists:
    size = int(TILE_SIZE)
    rows, columns = -(-frame.height // size), -(-frame.width // size)
    order = _front_to_back(splats.depths.numpy(), radii.numpy(), frame.cameras)
    splat_ids = _view(order)
    channels = splats.colors.dtype._length_
    record = record_size(channels)
    records = wp.empty(order.size * record, dtype=float, device="cpu")
    launch_range(
        pack_records_kernel(channels),
        order.size,
        inputs=[splat_ids, splats.means2d, splats.conics, splats.depths, splats.opacities, splats.colors],
        outputs=[records],
        device="cpu",
        threads=threads,
        min_chunk=4096,
        chunks_per_thread=2,
    )

    per_camera = max(1, splats.depths.size // frame.cameras)
    chunk = max(64, -(-order.size // (threads * _CHUNKS_PER_THREAD)))  # the lists are the same for any size
    chunks = -(-order.size // chunk)
    tile_counts = np.zeros((chunks, frame.cameras * rows * columns), dtype=np.int32)
    slot_counts = np.empty(order.size, dtype=np.int32)
    launch_range(
        count_chunk,
        chunks,
        inputs=[records, splat_ids, per_camera, record, chunk, rows, columns],
        outputs=[_view(tile_counts), _view(slot_counts)],
        device="cpu",
        threads=threads,
        chunks_per_thread=_CHUNKS_PER_THREAD,
    )

    tile_starts = _starts(tile_counts.sum(axis=0, dtype=np.int32))
    slot_starts = _starts(slot_counts)
    # Within a tile the chunks follow one another, so the order of depth is kept.
    cursors = np.cumsum(tile_counts, axis=0, dtype=np.int32) - tile_counts + tile_starts[:-1]
    intersections = int(slot_starts[-1])
    ranks = wp.empty(intersections, dtype=int, device="cpu")
    slots = wp.empty(intersections, dtype=int, device="cpu")
    launch_range(
        fill_chunk,
        chunks,
        inputs=[records, splat_ids, _view(slot_starts), per_camera, record, chunk, rows, columns],
        outputs=[_view(cursors), ranks, slots],
        device="cpu",
        threads=threads,
        chunks_per_thread=_CHUNKS_PER_THREAD,
    )
    return TileLists(splat_ids, records, ranks, slots, _view(tile_starts), _view(slot_starts))


def _front_to_back(depths: np.ndarray, radii: np.ndarray, cameras: int) -> np.ndarray:
    """Visible splats, camera by camera, by depth; equal depths by index. [M] int32"""
    depths = depths.reshape(cameras, -1)
    visible = radii[:, 0].reshape(cameras, -1) > 0
    order = []
    for c in range(cameras):
        ids = np.flatnonzero(visible[c])
        # A positive float sorts like its bits. With the index below them no two keys are equal, and any sort is stable.
        keys = (depths[c, ids].view(np.int32).astype(np.int64) << 32) | ids
        keys.sort()
        order.append((keys & 0xFFFFFFFF).astype(np.int32) + np.int32(c * depths.shape[1]))
    return np.concatenate(order)


def _starts(counts: np.ndarray) -> np.ndarray:
    """[K] -> [K + 1] where each begins, and the end."""
    return np.concatenate([np.zeros(1, np.int32), np.cumsum(counts, dtype=np.int32)])


def _view(array: np.ndarray) -> wp.array:
    return wp.array(array, dtype=int, device="cpu", copy=False)
