"""A photo of low contrast gets features enough to be matched, another keeps just what COLMAP finds."""

import cv2
import numpy as np

from graphgs.structure.colmap import ColmapWorker


def test_faint_texture_gives_features_too(tmp_path):
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.normal(0, 1, (480, 640)).astype(np.float32), (0, 0), 2.0)
    texture /= texture.std()
    counts = {}
    for name, contrast in (("plain", 30.0), ("faint", 2.2)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.clip(128 + contrast * texture, 0, 255).astype(np.uint8))
    with ColmapWorker(tmp_path) as worker:
        for name in ("plain", "faint"):
            worker.run(
                "extract",
                root=tmp_path,
                images=[f"{name}.png"],
                masks=[None],
                out=tmp_path / "features",
                max_side=640,
                max_features=2000,
                first_octave=0,
            )
            with np.load(tmp_path / "features" / f"{name}.png.npz") as found:
                counts[name] = len(found["keypoints"])
    assert counts["plain"] > 1000
    assert counts["faint"] > 400, counts
