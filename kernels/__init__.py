"""Pure device code, installed as `graphgs.kernels`: Warp and Taichi kernels with their launchers. No torch, no files."""
