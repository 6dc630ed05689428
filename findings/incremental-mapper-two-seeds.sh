#!/usr/bin/env bash
# pycolmap 4.2.1: two seeds of the incremental mapper are one opinion.
#
# Guess: random_seed (of the pipeline, the mapper, the triangulation and pycolmap.set_random_seed) makes the incremental
# mapper start and go on otherwise, so two runs with two seeds are two reconstructions, and their agreement is evidence.
# Behaviour: the first pair and the order of images follow from the matches alone, and bundle adjustment from any small
# difference ends in the same minimum. Three seeds on one database of noisy matches give the same poses to far below a
# millionth of a degree, while the noise of the observations moves them by some hundredths.
# Seen: images [12, 12, 12]; largest difference of a pairwise rotation between seeds 0, 1 and 12345: 1.32e-10 degrees
#
# Exits with 1 if seeds come to differ by more than 1e-6 degrees.
set -euo pipefail
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet numpy==2.2.6 pycolmap==4.2.1
cat > "$work/seeds.py" <<'PY'
import pathlib
import sys
import tempfile

import numpy as np
import pycolmap

pycolmap.logging.minloglevel = 3
work = pathlib.Path(tempfile.mkdtemp())
dataset = pycolmap.SyntheticDatasetOptions()
dataset.num_rigs, dataset.num_cameras_per_rig, dataset.num_frames_per_rig, dataset.num_points3D = 1, 1, 12, 400
pycolmap.set_random_seed(0)
with pycolmap.Database.open(work / "database.db") as database:
    truth = pycolmap.synthesize_dataset(dataset, database)
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev = 0.5
    pycolmap.synthesize_noise(noise, truth, database)

poses = []
for seed in (0, 1, 12345):
    pycolmap.set_random_seed(seed)
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=seed)
    options.mapper.random_seed = options.triangulation.random_seed = seed
    out = work / str(seed)
    out.mkdir()
    model = pycolmap.incremental_mapping(work / "database.db", work, out, options)[0]
    poses.append({image.name: image.cam_from_world() for image in model.images.values() if image.has_pose})


def relative(model, first, second):
    return (model[second] * model[first].inverse()).rotation


names = sorted(poses[0])
largest = max(
    np.degrees((relative(poses[0], a, b).inverse() * relative(other, a, b)).angle())
    for other in poses[1:]
    for a in names
    for b in names
)
print(
    f"images {[len(model) for model in poses]}; largest difference of a pairwise rotation between seeds 0, 1 and 12345: "
    f"{largest:.2e} degrees"
)
sys.exit(1 if largest > 1e-6 else 0)
PY
"$work/venv/bin/python" "$work/seeds.py" 2>/dev/null
