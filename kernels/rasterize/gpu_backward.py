"""Compositing on a GPU, backward: in each group of threads the splats stand still and the pixels walk past them.

A thread per pixel would have to add up ten numbers over the 256 threads of the block for every splat. Here a thread
holds a splat and sees the pixels one after another, so its sums stay in its own registers (the idea of Taming 3DGS,
Mallick et al. 2024). A group is 32 threads, which hold 32 splats of the tile's list, and 32 pixels: at each step thread
k looks at the pixel that thread k - 1 has just left, so every pixel meets the splats front to back. A thread that has
seen all pixels takes the splat 32 places on, while those behind it still finish: the pipeline never empties. The light
of a pixel and what lies behind it (docs/kernels.md) are two numbers in shared memory, one barrier per step hands them
on. Every 32 steps the sums of the 8 groups are added and written to the intersection's slot, without atomics.
"""

from functools import cache

import warp as wp

from graphgs.kernels.rasterize.blending import falloff_at, halves_light
from graphgs.kernels.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from graphgs.kernels.rasterize.gpu_forward import THREADS, find_pixel

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

GROUP = wp.constant(32)  # threads, splats and pixels of a group
GROUPS = wp.constant(8)  # of a block
COLOR = wp.constant(9)  # place of the colour in a row of sums; before it, see `gather_splats`


def row_length(channels: int) -> int:
    """Floats in an intersection's row of sums: a multiple of 4."""
    return 4 * -(-(int(COLOR) + channels) // 4)


@wp.func
def add_groups(
    part: wp.vec4,  # of each thread
    thread: int,
    slots: wp.array[int],
    first: int,  # intersection of thread 0
    stop: int,
    length: int,  # of a row
    at: int,  # place in the row
    # Out
    splat_sums: wp.array[float],
):
    """Write the sums of four numbers over the groups; threads 32 k + i write number k of splat i."""
    parts = wp.tile(part)
    i = thread % GROUP
    total = float(0.0)
    if thread < 4 * GROUP:
        for group in range(GROUPS):
            total += wp.tile_extract(parts, thread // GROUP, group * GROUP + i)
        if first + i < stop:
            splat_sums[slots[first + i] * length + at + thread // GROUP] = total


@cache
def gpu_backward_kernel(channels: int):
    vecD = wp.types.vector(channels, wp.float32)
    length = row_length(channels)
    vecS = wp.types.vector(length, wp.float32)

    @wp.kernel(
        enable_backward=False,
        module="unique",
        grid_stride=False,
        module_options={"max_unroll": 64},
        launch_bounds=(256, 3),
    )
    def gpu_backward(
        # Splats, [C * N]
        means2d: wp.array[wp.vec2],
        conics: wp.array[wp.vec3],
        depths: wp.array[float],
        opacities: wp.array[float],
        colors: wp.array[vecD],
        # Tiles
        splat_ids: wp.array[int],  # [I]
        slots: wp.array[int],  # [I]
        tile_ranges: wp.array[wp.vec2i],  # [C * tiles]
        tile_stops: wp.array[int],  # [C * tiles]
        # Frame
        width: int,
        height: int,
        backgrounds: wp.array[vecD],  # [C]
        # Rendered, and cotangents, [C * H * W]
        render_alphas: wp.array[float],
        color_sums: wp.array[vecD],
        depth_sums: wp.array[float],
        v_colors: wp.array[vecD],
        v_alphas: wp.array[float],
        v_depths: wp.array[float],
        v_median_depths: wp.array[float],  # or empty
        # Out
        splat_sums: wp.array[float],  # [I * row_length] by slot, zero before
    ):
        tile, thread = wp.tid()

        # Each thread prepares a pixel: transmittance and what lies behind; cotangents of depth, weight, median depth.
        c, px, py = find_pixel(tile, thread, width, height)
        light = wp.vec2(-1.0, 0.0)  # no light: it sees no splat
        pull = wp.vec3()
        if px < width and py < height:
            index = (c * height + py) * width + px
            alpha_sum = render_alphas[index]
            if alpha_sum > 0.0:
                v_color = v_colors[index]
                v_depth = v_depths[index] / alpha_sum
                v_weight = v_alphas[index] - wp.dot(v_color, backgrounds[c]) - v_depth * depth_sums[index] / alpha_sum
                remaining = v_weight * alpha_sum + v_depth * depth_sums[index] + wp.dot(v_color, color_sums[index])
                light = wp.vec2(1.0, remaining)
                v_median_depth = float(0.0)
                if v_median_depths.shape[0] > 0:
                    v_median_depth = v_median_depths[index]
                pull = wp.vec3(v_depth, v_weight, v_median_depth)
        lights = wp.tile(light, preserve_type=True)
        pulls = wp.tile(pull, preserve_type=True)

        # Then it takes splats.
        member = thread % GROUP
        first = tile_ranges[tile][0]
        stop = tile_stops[tile]
        spot = wp.vec4()
        conic = wp.vec3()
        color = vecD()
        sums = vecS()
        done = vecS()
        steps = (stop - first + GROUP - 1) // GROUP * GROUP + GROUP - 1
        for start in range(0, wp.where(stop > first, steps, 0), THREADS):
            next_spot = wp.vec4()
            next_conic = wp.vec3()
            next_color = vecD()
            i = first + start + thread
            if i < stop:
                s = splat_ids[i]
                next_spot = wp.vec4(means2d[s][0], means2d[s][1], opacities[s], depths[s])
                next_conic = conics[s]
                next_color = colors[s]
            spots = wp.tile(next_spot, preserve_type=True)
            shapes = wp.tile(next_conic, preserve_type=True)
            shades = wp.tile(next_color, preserve_type=True)
            for step in range(start, wp.min(start + THREADS, steps)):
                turn = step - member  # the splat's 32 pixels, then the next splat's
                place = thread - member + (turn & (GROUP - 1))
                if turn >= 0 and (turn & (GROUP - 1)) == 0:
                    at = (turn & (THREADS - 1)) + member
                    spot = wp.tile_extract(spots, at)
                    conic = wp.tile_extract(shapes, at)
                    color = wp.tile_extract(shades, at)
                    sums = vecS()
                light = wp.vec2(-1.0, 0.0)
                if turn >= 0:
                    light = wp.tile_extract(lights, place)
                taken = bool(False)
                if light[0] > 0.0:
                    c, px, py = find_pixel(tile, place, width, height)
                    offset = wp.vec2(float(px) + 0.5 - spot[0], float(py) + 0.5 - spot[1])
                    falloff = falloff_at(offset, conic)
                    alpha = wp.min(ALPHA_MAX, spot[2] * falloff)
                    if alpha >= ALPHA_MIN:
                        taken = True
                        behind = light[0] * (1.0 - alpha)
                        if behind <= TRANSMITTANCE_MIN:
                            light = wp.vec2(-1.0, 0.0)
                        else:
                            pull = wp.tile_extract(pulls, place)
                            v_color = v_colors[(c * height + py) * width + px]
                            weight = alpha * light[0]
                            gain = pull[1] + wp.dot(v_color, color) + pull[0] * spot[3]
                            remaining = light[1] - weight * gain
                            for k in range(channels):
                                sums[COLOR + k] += weight * v_color[k]
                            sums[8] += weight * pull[0]
                            if halves_light(light[0], behind):
                                sums[8] += pull[2]
                            if spot[2] * falloff <= ALPHA_MAX:  # the clamp has no gradient
                                v_sigma = alpha / (1.0 - alpha) * remaining - weight * gain
                                moment_x = v_sigma * offset[0]
                                moment_y = v_sigma * offset[1]
                                sums[0] += v_sigma
                                sums[1] += moment_x
                                sums[2] += moment_y
                                sums[3] += moment_x * offset[0]
                                sums[4] += moment_x * offset[1]
                                sums[5] += moment_y * offset[1]
                                sums[6] += wp.abs(conic[0] * moment_x + conic[1] * moment_y)
                                sums[7] += wp.abs(conic[1] * moment_x + conic[2] * moment_y)
                            light = wp.vec2(behind, remaining)
                if (turn & (GROUP - 1)) == GROUP - 1:
                    done = vecS(sums)
                wp.tile_scatter_masked(lights, place, light, taken)
                # The last thread of each group has just finished a splat, and the first has not finished another.
                if step >= 2 * (GROUP - 1) and (step & (GROUP - 1)) == GROUP - 2:
                    for k in range(length // 4):
                        part = wp.vec4(done[4 * k], done[4 * k + 1], done[4 * k + 2], done[4 * k + 3])
                        i = first + step - 2 * (GROUP - 1)
                        add_groups(part, thread, slots, i, stop, length, 4 * k, splat_sums)

    return gpu_backward


@cache
def gather_splats_kernel(channels: int):
    vecD = wp.types.vector(channels, wp.float32)
    length = row_length(channels)

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False, module_options={"max_unroll": 64})
    def gather_splats(
        order: wp.array[int],  # [C * N]
        slot_ends: wp.array[int],  # [C * N]
        # Splats, [C * N]
        conics: wp.array[wp.vec3],
        opacities: wp.array[float],
        splat_sums: wp.array[float],  # [I * row_length]
        # Out, [C * N], zero before
        v_means2d: wp.array[wp.vec2],
        v_conics: wp.array[wp.vec3],
        v_depths: wp.array[float],
        v_opacities: wp.array[float],
        v_colors: wp.array[vecD],
        v_abs_means2d: wp.array[wp.vec2],  # or empty
    ):
        rank = wp.tid()
        slot = int(0)
        if rank > 0:
            slot = slot_ends[rank - 1]
        end = slot_ends[rank]
        if slot < end:
            pull = wp.vec3()
            spread = wp.vec3()
            strength = wp.vec2()
            v_depth = float(0.0)
            v_color = vecD()
            for i in range(slot, end):
                at = i * length
                pull += wp.vec3(splat_sums[at], splat_sums[at + 1], splat_sums[at + 2])
                spread += wp.vec3(splat_sums[at + 3], splat_sums[at + 4], splat_sums[at + 5])
                strength += wp.vec2(splat_sums[at + 6], splat_sums[at + 7])
                v_depth += splat_sums[at + 8]
                for k in range(channels):
                    v_color[k] += splat_sums[at + COLOR + k]
            s = order[rank]
            # sigma = (a dx^2 + c dy^2) / 2 + b dx dy, with dx = pixel - mean; alpha = opacity * exp(-sigma)
            a, b, c = conics[s][0], conics[s][1], conics[s][2]
            v_means2d[s] = -wp.vec2(a * pull[1] + b * pull[2], b * pull[1] + c * pull[2])
            v_conics[s] = wp.vec3(0.5 * spread[0], spread[1], 0.5 * spread[2])
            v_opacities[s] = -pull[0] / opacities[s]
            v_depths[s] = v_depth
            v_colors[s] = v_color
            if v_abs_means2d.shape[0] > 0:
                v_abs_means2d[s] = strength

    return gather_splats
