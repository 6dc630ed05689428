"""The stages by place, name and version. Light to import: what only reads artefacts needs no more of the pipeline."""

from graphgs.workspace import Stage

PHOTOS = Stage(1, "photos", 3)
COARSE = Stage(2, "coarse", 5)
GIVEN = Stage(2, "given", 1)  # only where poses came with the photos; its place is before COARSE
PAIRS = Stage(3, "pairs", 3)
MATCHES = Stage(4, "matches", 4)
MAPPING = Stage(5, "mapping", 6)
VIEWS = Stage(6, "views", 1)
GRAPH = Stage(7, "graph", 1)
DENSE = Stage(8, "dense", 1)
POINTS = Stage(9, "points", 2)
TRAINING = Stage(10, "training", 3)
EVALUATION = Stage(11, "evaluation", 2)
STAGES = (PHOTOS, COARSE, PAIRS, MATCHES, MAPPING, VIEWS, GRAPH, DENSE, POINTS, TRAINING, EVALUATION)
