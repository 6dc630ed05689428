"""Pure device code, installed as `graphgs.kernels`: Warp and Taichi kernels and launchers. No torch, no files."""
