"""Which photos look alike: VLAD (Jegou et al. 2010) over a small vocabulary trained on the scene's own descriptors."""

from itertools import pairwise

import numpy as np

_TRAINING_DESCRIPTORS = 12_000  # enough for 64 words, and a bound on the time
_TRAINING_ROUNDS = 10


def similar_photos(
    descriptors: np.ndarray,  # [F, 128] uint8, image after image
    offsets: np.ndarray,  # [N + 1] rows of each image
    *,
    words: int,
    neighbors: int,
    seed: int,
) -> np.ndarray:
    """[N, neighbors] int, the most similar other photos of each, best first; -1 where there are no more.

    A photo without features is like no other."""
    n = len(offsets) - 1
    result = np.full((n, neighbors), -1, dtype=np.int64)
    if len(descriptors) == 0:
        return result
    empty = np.diff(offsets) == 0
    signatures = _signatures(descriptors, offsets, words=words, seed=seed)
    for first in range(0, n, 512):
        similarity = signatures[first : first + 512] @ signatures.T
        similarity[np.arange(len(similarity)), np.arange(first, first + len(similarity))] = -np.inf
        similarity[empty[first : first + len(similarity)]] = -np.inf
        similarity[:, empty] = -np.inf
        ranked = np.argsort(-similarity, axis=1, kind="stable")[:, : min(neighbors, n - 1)]
        ranked[np.isneginf(np.take_along_axis(similarity, ranked, axis=1))] = -1
        result[first : first + len(ranked), : ranked.shape[1]] = ranked
    return result


def _signatures(descriptors: np.ndarray, offsets: np.ndarray, *, words: int, seed: int) -> np.ndarray:
    """[N, words * 128] unit vectors: per word the sum of residuals, normalised within the word, then as a whole."""
    rng = np.random.default_rng(seed)
    total = len(descriptors)
    sample = np.sort(rng.choice(total, min(total, _TRAINING_DESCRIPTORS), replace=False))
    vocabulary = _train(_unit(descriptors[sample]), min(words, len(sample)), rng)
    signatures = np.zeros((len(offsets) - 1, len(vocabulary), descriptors.shape[1]), np.float32)
    for i, (first, last) in enumerate(pairwise(offsets)):
        features = _unit(descriptors[first:last])
        sums, counts = _by_word(features, _nearest(features, vocabulary), len(vocabulary))
        signatures[i] = sums - counts * vocabulary
    signatures /= np.maximum(np.linalg.norm(signatures, axis=2, keepdims=True), 1e-12)
    signatures = signatures.reshape(len(signatures), -1)
    return signatures / np.maximum(np.linalg.norm(signatures, axis=1, keepdims=True), 1e-12)


def _train(sample: np.ndarray, words: int, rng: np.random.Generator) -> np.ndarray:
    """k-means centres [words, 128] of unit descriptors; a word that loses all its members keeps its place."""
    centers = sample[rng.choice(len(sample), words, replace=False)]
    for _ in range(_TRAINING_ROUNDS):
        sums, counts = _by_word(sample, _nearest(sample, centers), len(centers))
        centers = np.where(counts > 0, sums / np.maximum(counts, 1), centers)
    return centers


def _by_word(features: np.ndarray, nearest: np.ndarray, words: int) -> tuple[np.ndarray, np.ndarray]:
    """(sum [words, 128], count [words, 1]) of the features of each word, as one product with a membership matrix."""
    member = (nearest[None, :] == np.arange(words)[:, None]).astype(np.float32)
    return member @ features, member.sum(1, keepdims=True)


def _nearest(features: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """[F] index of the nearest centre by squared distance; the features' own norm does not matter."""
    return np.argmin((centers**2).sum(1) - 2.0 * features @ centers.T, axis=1)


def _unit(descriptors: np.ndarray) -> np.ndarray:
    features = descriptors.astype(np.float32)
    return features / np.maximum(np.linalg.norm(features, axis=1, keepdims=True), 1e-12)
