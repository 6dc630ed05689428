"""Compositing on a GPU, backward: in each group of threads the splats stand still and the pixels walk past them.

A thread per pixel would have to add up a dozen numbers over the 256 threads of the block for every splat. Here a thread
holds a splat and sees pixels one after another, so its sums stay in its registers (a thread per splat, as in Taming
3DGS, Mallick et al. 2024). A group is 32 threads, which hold 32 splats of the tile's list, and 32 pixels: at each step
thread k looks at the pixel that thread k - 1 has just left, so every pixel meets the splats front to back. A thread
that has seen all pixels takes the splat 32 places on while those behind it still finish: the pipeline never runs empty.

What a pixel carries along, its light and what still lies behind (docs/kernels.md), are two numbers in shared memory.
Every 32 steps, the sums of the 8 groups are added in their order and written to the intersection's slot, and at the end
a thread per splat adds its slots: no atomics, the same bits every time.
"""

from functools import cache
from typing import Any

import warp as wp

from graphgs.kernels.rasterize.blending import falloff_at, halves_light
from graphgs.kernels.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TILE_SIZE, TRANSMITTANCE_MIN
from graphgs.kernels.rasterize.gpu_forward import THREADS, find_pixel

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

GROUP = wp.constant(32)  # threads, splats and pixels of a group
GROUPS = wp.constant(8)  # of a block
COLOR = wp.constant(9)  # where the colour begins among the sums


def sums_type(channels: int) -> type:
    """An intersection's sums over pixels: with s = dL/dsigma, s, s dx, s dy, s dx^2, s dx dy, s dy^2; the two of
    |share of v_mean2d|; v_depth; v_color."""
    return wp.types.vector(int(COLOR) + channels, wp.float32)


@wp.func
def add_groups(
    finished: Any,  # tile [THREADS] of rows, the sums of each thread
    thread: int,
    slots: wp.array[int],
    first: int,  # intersection of each group's first thread
    stop: int,
    # Out
    splat_sums: wp.array[Any],
):
    """Write the sums over the groups, a row for each of the 32 splats."""
    i = first + thread
    if thread < GROUP and i < stop:
        total = wp.tile_extract(finished, thread)
        for group in range(1, GROUPS):
            total += wp.tile_extract(finished, group * GROUP + thread)
        splat_sums[slots[i]] = total


@cache
def gpu_backward_kernel(channels: int):
    vecD = wp.types.vector(channels, wp.float32)
    vecS = sums_type(channels)
    vecR = wp.types.vector(7 + channels, wp.float32)

    @wp.kernel(
        enable_backward=False,
        module="unique",
        grid_stride=False,
        module_options={"max_unroll": 64},  # a loop over channels that is left a loop would put its vectors in memory
        launch_bounds=(int(THREADS), 4 if channels <= 3 else 1),  # 64 registers are enough for three channels
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
        render_depths: wp.array[float],
        color_sums: wp.array[vecD],
        v_colors: wp.array[vecD],
        v_alphas: wp.array[float],
        v_depths: wp.array[float],
        v_median_depths: wp.array[float],  # or empty
        # Out
        splat_sums: wp.array[vecS],  # [I] by slot, zero before
    ):
        tile, thread = wp.tid()

        # Each thread prepares a pixel: its light and what lies behind; the cotangents of depth, weight, median depth.
        c, px, py = find_pixel(tile, thread, width, height)
        light = wp.vec2(-1.0, 0.0)  # no light: it sees no splat
        pull = wp.vec3()
        if px < width and py < height:
            index = (c * height + py) * width + px
            alpha_sum = render_alphas[index]
            if alpha_sum > 0.0:
                v_color = v_colors[index]
                v_depth = v_depths[index] / alpha_sum
                v_light = v_alphas[index] - wp.dot(v_color, backgrounds[c])
                light = wp.vec2(1.0, v_light * alpha_sum + wp.dot(v_color, color_sums[index]))
                v_median_depth = float(0.0)
                if v_median_depths.shape[0] > 0:
                    v_median_depth = v_median_depths[index]
                pull = wp.vec3(v_depth, v_light - v_depth * render_depths[index], v_median_depth)
        lights = wp.tile(light, preserve_type=True)
        pulls = wp.tile(pull, preserve_type=True)
        # A record: mean, opacity, depth, conic, colour. Each group takes 32 of them at a time.
        records = wp.tile_zeros(shape=GROUP, dtype=vecR, storage="shared")
        finished = wp.tile_zeros(shape=THREADS, dtype=vecS, storage="shared")

        # From here on a thread owns splats: every 32nd of the list, beginning with its place in the group.
        member = thread % GROUP
        left = float(px - thread % TILE_SIZE) + 0.5
        top = float(py - thread // TILE_SIZE) + 0.5
        corner = (c * height + py - thread // TILE_SIZE) * width + px - thread % TILE_SIZE
        first = tile_ranges[tile][0]
        stop = tile_stops[tile]
        splat = vecR()
        sums = vecS()
        steps = (stop - first + GROUP - 1) // GROUP * GROUP + GROUP - 1
        for step in range(wp.where(stop > first, steps, 0)):
            if (step & (GROUP - 1)) == 0:
                record = vecR()
                i = first + step + thread
                if thread < GROUP and i < stop:
                    s = splat_ids[i]
                    record[0] = means2d[s][0]
                    record[1] = means2d[s][1]
                    record[2] = opacities[s]
                    record[3] = depths[s]
                    for k in range(3):
                        record[4 + k] = conics[s][k]
                    for k in range(channels):
                        record[7 + k] = colors[s][k]
                wp.tile_scatter_masked(records, thread, record, thread < GROUP)
            turn = step - member  # the splat's 32 pixels, then the next splat's
            walk = turn & (GROUP - 1)
            place = thread - member + walk
            if walk == 0 and turn >= 0:
                splat = wp.tile_extract(records, member)
                sums = vecS()
            here = wp.tile_extract(lights, place)
            dx = left + float(place % TILE_SIZE) - splat[0]
            dy = top + float(place // TILE_SIZE) - splat[1]
            falloff = falloff_at(wp.vec2(dx, dy), wp.vec3(splat[4], splat[5], splat[6]))
            alpha = wp.min(ALPHA_MAX, splat[2] * falloff)
            taken = here[0] > 0.0 and alpha >= ALPHA_MIN
            if taken:
                transmittance = here[0]
                behind = transmittance * (1.0 - alpha)
                here[0] = -1.0
                if behind > TRANSMITTANCE_MIN:
                    here[0] = behind
                    cotangents = wp.tile_extract(pulls, place)
                    shade = v_colors[corner + place // TILE_SIZE * width + place % TILE_SIZE]
                    weight = alpha * transmittance
                    gain = cotangents[1] + cotangents[0] * splat[3]
                    for k in range(channels):
                        gain += shade[k] * splat[7 + k]
                        sums[COLOR + k] += weight * shade[k]
                    here[1] -= weight * gain
                    sums[8] += weight * cotangents[0]
                    if halves_light(transmittance, behind):
                        sums[8] += cotangents[2]
                    if splat[2] * falloff <= ALPHA_MAX:  # the clamp has no gradient
                        v_sigma = alpha / (1.0 - alpha) * here[1] - weight * gain
                        moment_x = v_sigma * dx
                        moment_y = v_sigma * dy
                        sums[0] += v_sigma
                        sums[1] += moment_x
                        sums[2] += moment_y
                        sums[3] += moment_x * dx
                        sums[4] += moment_x * dy
                        sums[5] += moment_y * dy
                        sums[6] += wp.abs(splat[4] * moment_x + splat[5] * moment_y)
                        sums[7] += wp.abs(splat[5] * moment_x + splat[6] * moment_y)
            wp.tile_scatter_masked(lights, place, here, taken)
            wp.tile_scatter_masked(finished, thread, sums, walk == GROUP - 1)
            # The last thread of each group has just finished a splat, and the first has not finished another.
            if step >= 2 * (GROUP - 1) and (step & (GROUP - 1)) == GROUP - 2:
                add_groups(finished, thread, slots, first + step - 2 * (GROUP - 1), stop, splat_sums)

    return gpu_backward


@cache
def gather_splats_kernel(channels: int):
    vecD = wp.types.vector(channels, wp.float32)
    vecS = sums_type(channels)

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False, module_options={"max_unroll": 64})
    def gather_splats(
        order: wp.array[int],  # [C * N]
        slot_ends: wp.array[int],  # [C * N]
        # Splats, [C * N]
        conics: wp.array[wp.vec3],
        opacities: wp.array[float],
        splat_sums: wp.array[vecS],  # [I]
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
            total = vecS()
            for i in range(slot, end):
                total += splat_sums[i]
            s = order[rank]
            # sigma = (a dx^2 + c dy^2) / 2 + b dx dy, with dx = pixel - mean; alpha = opacity * exp(-sigma)
            a, b, c = conics[s][0], conics[s][1], conics[s][2]
            v_means2d[s] = -wp.vec2(a * total[1] + b * total[2], b * total[1] + c * total[2])
            v_conics[s] = wp.vec3(0.5 * total[3], total[4], 0.5 * total[5])
            v_opacities[s] = -total[0] / opacities[s]
            v_depths[s] = total[8]
            v_color = vecD()
            for k in range(channels):
                v_color[k] = total[COLOR + k]
            v_colors[s] = v_color
            if v_abs_means2d.shape[0] > 0:
                v_abs_means2d[s] = wp.vec2(total[6], total[7])

    return gather_splats
