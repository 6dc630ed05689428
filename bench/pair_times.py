"""Match pairs in a database and write down what each of them cost: `python -m bench.pair_times DATABASE PAIRS OUT`.

A process of its own. It continues where it was stopped.
"""

import sys
import time
import zlib  # noqa: F401  (zlib and numpy first: pycolmap bundles libraries of the same names)
from pathlib import Path

import numpy as np

CHUNK = 8  # pairs timed together: a call has a cost of its own, which real runs share among many more
SAVE_EVERY = 20  # chunks


def main(database: Path, pairs_file: Path, out: Path) -> None:
    import pycolmap  # here: whoever imports this file has loaded libraries that it must not stand beside

    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    matching = pycolmap.FeatureMatchingOptions(num_threads=1, use_gpu=False)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    with pycolmap.Database.open(database) as db:
        names = [db.read_image(i + 1).name for i in range(db.num_images())]
    pairs = [tuple(pair) for pair in np.load(pairs_file).tolist()]
    seconds = load_times(out)
    pending = [pair for pair in pairs if pair not in seconds]
    listing = out.with_suffix(".txt")
    for count, first in enumerate(range(0, len(pending), CHUNK), 1):
        chunk = pending[first : first + CHUNK]
        listing.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in chunk))
        before = time.process_time()
        pycolmap.match_image_pairs(
            database,
            matching,
            pycolmap.ImportedPairingOptions(match_list_path=listing),
            verification,
            pycolmap.Device.cpu,
        )
        seconds |= dict.fromkeys(chunk, (time.process_time() - before) / len(chunk))
        if count % SAVE_EVERY == 0:
            save_times(out, seconds)
    save_times(out, seconds)
    listing.unlink(missing_ok=True)


def load_times(out: Path) -> dict[tuple[int, int], float]:
    if not out.exists():
        return {}
    with np.load(out) as arrays:
        return dict(zip(map(tuple, arrays["pairs"].tolist()), arrays["seconds"].tolist(), strict=True))


def save_times(out: Path, seconds: dict[tuple[int, int], float]) -> None:
    partial = out.with_suffix(".partial.npz")
    pairs = np.array(list(seconds), dtype=np.int64).reshape(-1, 2)
    np.savez(partial, pairs=pairs, seconds=list(seconds.values()))
    partial.rename(out)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
