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
from graphgs.kernels.rasterize.ellipse import alpha_ellipse
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


# Visits, rank after rank, every tile that a splat's ellipse covers a pixel centre's row and column of: `cells_between`
# of ellipse.py for its rows, then `band_extent` and `cells_between` for the columns of four rows at once.
_VISIT_TILES = f"""
    typedef float four __attribute__((ext_vector_type(4)));
    typedef int ints __attribute__((ext_vector_type(4)));
    auto larger = [](four a, four b) -> four {{ return a > b ? a : b; }};
    auto smaller = [](four a, four b) -> four {{ return a < b ? a : b; }};
    auto clamp = [](float x, float limit) -> float {{ return x < -1.0f ? -1.0f : (x > limit ? limit : x); }};
    const float right_end = 16.0f * columns + 1.0f, lower_end = 16.0f * rows + 1.0f;
    for (int rank = begin; rank < end; ++rank) {{
        const float* s = records.data + (long)rank * record_size;
        const float slope = s[{ELLIPSE}], height = s[{ELLIPSE} + 1], right_y = s[{ELLIPSE} + 2];
        const float flatness = s[{ELLIPSE} + 3], width = s[{ELLIPSE} + 4];
        const int top_px = (int)__builtin_ceilf(clamp(s[1] - height, lower_end) - 0.5f);
        const int bottom_px = (int)__builtin_floorf(clamp(s[1] + height, lower_end) - 0.5f);
        const int first_row = top_px > bottom_px ? 0 : (top_px >> 4 > 0 ? top_px >> 4 : 0);
        const int last_row = top_px > bottom_px ? -1 : (bottom_px >> 4 < rows ? bottom_px >> 4 : rows - 1);
        const int base = splat_ids.data[rank] / splats * rows * columns;
        BEGIN
        for (int row = first_row; row <= last_row; row += 4) {{
            const four top = 16.0f * row + 0.5f - s[1] + (four){{0, 16, 32, 48}};
            const four lo = larger(top, (four)-height), hi = smaller(top + 15.0f, (four)height);
            const four at_left = smaller(larger((four)-right_y, lo), hi);
            const four at_right = smaller(larger((four)right_y, lo), hi);
            const four left_chord = larger(width - flatness * at_left * at_left, (four)0.0f);
            const four right_chord = larger(width - flatness * at_right * at_right, (four)0.0f);
            const four left = s[0] - slope * at_left - __builtin_elementwise_sqrt(left_chord);
            const four right = s[0] - slope * at_right + __builtin_elementwise_sqrt(right_chord);
            const four first_px = smaller(larger(left, (four)-1.0f), (four)right_end) - 0.5f;
            const four last_px = smaller(larger(right, (four)-1.0f), (four)right_end) - 0.5f;
            const ints first = __builtin_convertvector(__builtin_elementwise_ceil(first_px), ints);
            const ints last = __builtin_convertvector(__builtin_elementwise_floor(last_px), ints);
            const ints met = (lo <= hi) & (first <= last);
            for (int k = 0; k < 4 && row + k <= last_row; ++k) {{
                if (!met[k]) continue;
                const int past = last[k] >> 4 < columns ? (last[k] >> 4) + 1 : columns;
                for (int column = first[k] >> 4 > 0 ? first[k] >> 4 : 0; column < past; ++column) {{
                    const int tile = base + (row + k) * columns + column;
                    VISIT
                }}
            }}
        }}
        END
    }}
"""


def _visit_tiles(begin: str, visit: str, end: str) -> str:
    return _VISIT_TILES.replace("BEGIN", begin).replace("VISIT", visit).replace("END", end)


@wp.func_native(
    "int* counts = tile_counts.data + (long)chunk * tiles;"
    + _visit_tiles("int count = 0;", "++counts[tile]; ++count;", "slot_counts.data[rank] = count;")
)
def count_tiles(
    records: wp.array[float],
    record_size: int,
    splat_ids: wp.array[int],
    splats: int,
    begin: int,  # ranks
    end: int,
    rows: int,
    columns: int,
    chunk: int,
    tiles: int,
    tile_counts: wp.array2d[int],
    slot_counts: wp.array[int],
):
    """Count the tiles of each splat and the splats of each tile."""


@wp.func_native(
    "int* at = cursors.data + (long)chunk * tiles;"
    + _visit_tiles(
        "int slot = slot_starts.data[rank];",
        "const int i = at[tile]++; ranks.data[i] = rank; slots.data[i] = slot++;",
        "",
    )
)
def fill_tiles(
    records: wp.array[float],
    record_size: int,
    splat_ids: wp.array[int],
    splats: int,
    begin: int,  # ranks
    end: int,
    rows: int,
    columns: int,
    chunk: int,
    tiles: int,
    slot_starts: wp.array[int],
    cursors: wp.array2d[int],
    ranks: wp.array[int],
    slots: wp.array[int],
):
    """Write each splat into the lists of its tiles, and count its slots on."""


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
    begin = chunk * chunk_size
    end = wp.min(begin + chunk_size, splat_ids.shape[0])
    tiles = tile_counts.shape[1]
    count_tiles(
        records, record_size, splat_ids, splats, begin, end, rows, columns, chunk, tiles, tile_counts, slot_counts
    )


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
    begin = chunk * chunk_size
    end = wp.min(begin + chunk_size, splat_ids.shape[0])
    tiles = cursors.shape[1]
    fill_tiles(
        records,
        record_size,
        splat_ids,
        splats,
        begin,
        end,
        rows,
        columns,
        chunk,
        tiles,
        slot_starts,
        cursors,
        ranks,
        slots,
    )


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
