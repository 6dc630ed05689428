"""Which images of a reconstruction see the same points."""

import numpy as np
from scipy import sparse

from graphgs.scene.reconstruction import Reconstruction


def shared_points(reconstruction: Reconstruction) -> sparse.csr_matrix:
    """[N, N] int, symmetric, nothing on the diagonal: the points two images both see; one seen twice counts once."""
    n, p = len(reconstruction.names), len(reconstruction.points)
    point = np.repeat(np.arange(p), reconstruction.track_lengths)
    seen = sparse.csr_matrix((np.ones(len(point), np.int64), (reconstruction.track_images, point)), shape=(n, p))
    seen.data[:] = 1
    shared = (seen @ seen.T).tolil()
    shared.setdiag(0)
    return shared.tocsr()
