"""The reprojection kernels have one shape for every device; it compiles for sm_86."""

import warp as wp

from graphgs.kernels.reproject import consistency


def test_it_compiles_for_sm_86(tmp_path):
    wp.compile_aot_module(consistency, arch=[86], module_dir=tmp_path)
    assert list(tmp_path.glob("*sm86.*"))
