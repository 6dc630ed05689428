"""Pairs by COLMAP's vocabulary tree, trained on the photos themselves:
`python -m bench.vocabulary_tree DATABASE K OUT` writes [P, 2] int, i < j, each photo with its K best look-alikes.

A process of its own, as it loads pycolmap.
"""

import sys
import zlib  # noqa: F401  (zlib and numpy first: pycolmap bundles libraries of the same names)
from pathlib import Path

import numpy as np

FEATURES_PER_WORD = 40  # in training; the default of 65,536 words is made for millions of pictures


def main(database: Path, partners: int, out: Path) -> None:
    import pycolmap  # here: whoever imports this file has loaded libraries that it must not stand beside

    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    pycolmap.set_random_seed(0)
    with pycolmap.Database.open(database) as db:
        described = [db.read_descriptors(i + 1) for i in range(db.num_images())]
        tree = pycolmap.VisualIndex.create(128, 64)
        every = np.concatenate([d.data for d in described]).astype(np.float32)
        words = max(len(every) // FEATURES_PER_WORD, 1)
        building = pycolmap.VisualIndex.BuildOptions(num_visual_words=words, num_threads=1)
        tree.build(building, pycolmap.FeatureDescriptorsFloat(described[0].type, every))
        stored = out.with_suffix(".tree")
        tree.write(stored)
        options = pycolmap.VocabTreePairingOptions(vocab_tree_path=stored, num_images=partners, num_threads=1)
        ids = np.array(pycolmap.VocabTreePairGenerator(options, db).all_pairs(), dtype=np.int64) - 1
    stored.unlink()
    pairs = np.unique(np.sort(ids, axis=1), axis=0)
    np.save(out, pairs[pairs[:, 0] < pairs[:, 1]])


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
