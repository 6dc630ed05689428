"""Do one scale and one bearing hold on both sides of a weak place?

Points that both sides see are placed from each side alone, and the two clouds are compared: where a reconstruction
broke, one is larger than the other, or turned. Bundle adjustment does not object, for it drops the few observations
that would.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.calibration.points import Observations, fitted, sums
from graphgs.structure.calibration.projection import linearise
from graphgs.structure.contradictions import PointLookup
from graphgs.structure.evidence import VerifiedMatches

_DEEP = 0.15  # relative deviation of a distance: points placed less well from a side say nothing about its scale
_FEWEST = 8  # points placed from both sides
_MOST = 2000  # looked at, evenly spread: they tell the scale to a tenth of a per cent
_LOSS_PX = 2.0  # a point that fits its side worse is a wrong match
_ROUNDS = 20
JUMP = 0.03  # of the scale: less is within what bundle adjustment leaves
TURN_DEG = 0.5  # of the bearing
OPEN = 0.05  # standard deviation of the scale: more, and it hangs on hardly anything
_CERTAIN = 4.0  # standard deviations


@dataclass(frozen=True)
class ScaleAcross:
    """The scale of one side of a cut in units of the other."""

    first: str  # two photos on either side that share the most points
    second: str
    photos: int  # on the smaller side
    points: int  # placed from both sides
    ratio: float  # of scales; 1 = one scale; nan where too few points say
    deviation: float  # standard deviation of its logarithm
    turn_deg: float  # between the clouds of points
    turn_deviation_deg: float
    freedom: float  # the deviation that all points seen from both sides leave, if either side is rigid

    @property
    def jumps(self) -> bool:
        if self.points < _FEWEST:
            return False
        scaled = abs(np.log(self.ratio)) > max(_CERTAIN * self.deviation, JUMP)
        return bool(scaled or self.turn_deg > max(_CERTAIN * self.turn_deviation_deg, TURN_DEG))

    @property
    def holds(self) -> bool:
        """Whether the points say that it is one scale and one bearing."""
        return bool(
            self.points >= _FEWEST
            and self.deviation < JUMP / 2
            and abs(np.log(self.ratio)) <= JUMP
            and self.turn_deg <= TURN_DEG
        )

    @property
    def is_open(self) -> bool:
        return not self.holds and _CERTAIN * self.freedom > OPEN

    @property
    def where(self) -> str:
        return f"between {self.first} and {self.second} ({self.photos} photos on the smaller side)"

    def describe(self) -> str:
        where = self.where
        if self.jumps:
            return (
                f"the reconstruction is broken {where}: {self.points} points, placed from one side and from the other, "
                f"differ by a factor of {max(self.ratio, 1 / self.ratio):.2f} and {self.turn_deg:.1f} degrees"
            )
        return f"hardly anything fixes the scale {where}: it may differ by {100 * _CERTAIN * self.freedom:.0f} %"


@dataclass(frozen=True)
class MatchedPoints:
    """The triangulated points at both ends of verified matches between photos of a model."""

    images: np.ndarray  # [K, 2] int into the model's names
    points: np.ndarray  # [K, 2] int into its points

    @staticmethod
    def of(model: Reconstruction, names: tuple[str, ...], verified: VerifiedMatches) -> "MatchedPoints":
        """`names` [N] are the photos that the matches count."""
        row = {name: k for k, name in enumerate(model.names)}
        image_of = np.array([row.get(name, -1) for name in names], np.int64)
        images = image_of[verified.pairs][verified.pair_of]
        at = np.flatnonzero((images >= 0).all(1))
        lookup = PointLookup(model)
        ends = ((images[at, 0], verified.xy_i[at]), (images[at, 1], verified.xy_j[at]))
        points = np.stack([lookup.points(image, xy) for image, xy in ends], axis=1)
        known = (points >= 0).all(1)
        return MatchedPoints(images[at][known], points[known])


def scale_across(
    model: Reconstruction,
    matched: MatchedPoints,
    side: np.ndarray,  # [M] bool per photo of the model
) -> ScaleAcross | None:
    """None where no point is seen from both sides."""
    sides = side[matched.images]
    across = np.flatnonzero(sides[:, 0] != sides[:, 1])
    if not len(across):
        return None
    images, points, turned = matched.images[across], matched.points[across], sides[across, 0]
    points = np.where(turned[:, None], points[:, ::-1], points)  # the first column: seen from where `side` is False
    pairs = np.unique(points, axis=0)
    pairs = pairs[np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST)).round().astype(np.int64))]
    ties, counts = np.unique(images, axis=0, return_counts=True)
    first, second = (model.names[int(k)] for k in ties[int(counts.argmax())])
    middle = np.median(model.centers[np.unique(images)], axis=0)
    fit = _compared(model, pairs, side, middle)
    smaller = int(min(side.sum(), (~side).sum()))
    together = np.unique(pairs[pairs[:, 0] == pairs[:, 1]][:, 0])
    freedom = _freedom(model, together, side, middle)
    return ScaleAcross(first, second, smaller, freedom=freedom, **dataclasses.asdict(fit))


@dataclass(frozen=True)
class _Fit:
    ratio: float
    deviation: float  # of its logarithm
    turn_deg: float
    turn_deviation_deg: float
    points: int


def _compared(model: Reconstruction, pairs: np.ndarray, side: np.ndarray, middle: np.ndarray) -> _Fit:
    """Of the points [K, 2] as placed by either side alone."""
    clouds, shapes, good = [], [], np.ones(len(pairs), bool)
    for column, wanted in enumerate((False, True)):
        seen = _of_side(Observations.of(model, pairs[:, column]), side, wanted)
        enough = np.bincount(seen.track, minlength=seen.count) >= 2
        found = fitted(model, seen)
        eyes = sums(model.centers[seen.images], seen.track, seen.count)
        eyes /= np.maximum(np.bincount(seen.track, minlength=seen.count), 1)[:, None]
        rays = found.place - eyes
        distance = np.linalg.norm(rays, axis=1)
        shape = np.linalg.pinv(np.where(enough[:, None, None], found.information, np.eye(3)), hermitian=True)
        along = np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", rays, shape, rays), 0.0)) / np.maximum(distance, 1e-9) ** 2
        good &= enough & np.isfinite(found.loss) & (found.loss < _LOSS_PX) & (along < _DEEP)
        clouds.append(found.place - middle)
        shapes.append(shape)
    if good.sum() < _FEWEST:
        return _Fit(np.nan, np.inf, np.nan, np.inf, int(good.sum()))
    inverse = np.linalg.inv(shapes[0][good] + shapes[1][good])
    return _similarity(clouds[0][good], clouds[1][good], inverse)


def _of_side(seen: Observations, side: np.ndarray, wanted: bool) -> Observations:
    rows = side[seen.images] == wanted
    return Observations(seen.count, seen.track[rows], seen.images[rows], seen.seen[rows])


def _similarity(x: np.ndarray, y: np.ndarray, inverse: np.ndarray) -> _Fit:
    """The similarity that takes points x [K, 3] to y, with the inverse covariances [K, 3, 3] of their differences;
    robustly."""
    turn, shift, log = np.eye(3), np.zeros(3), 0.0
    for _ in range(_ROUNDS):
        moved = np.exp(log) * x @ turn.T
        rest = moved + shift - y
        distance2 = np.einsum("ki,kij,kj->k", rest, inverse, rest)
        level = max(float(np.median(distance2)) / 2.37, 1e-12)  # the median of chi squared with three degrees
        weight = 1.0 / (1.0 + distance2 / level / 3.0)
        J = np.concatenate([np.broadcast_to(np.eye(3), (len(x), 3, 3)), -_cross(moved), moved[:, :, None]], axis=2)
        normal = np.einsum("k,kia,kij,kjb->ab", weight, J, inverse, J)
        step = -np.linalg.pinv(normal, hermitian=True) @ np.einsum("k,kia,kij,kj->a", weight, J, inverse, rest)
        shift = shift + step[:3]
        turn = _rotation(step[3:6]) @ turn
        log += float(np.clip(step[6], -0.5, 0.5))
        shift = shift if np.isfinite(shift).all() else np.zeros(3)
    covariance = np.linalg.pinv(normal, hermitian=True) * level
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    turning = np.degrees(np.sqrt(max(np.linalg.eigvalsh(covariance[3:6, 3:6])[-1], 0.0)))
    return _Fit(float(np.exp(log)), float(np.sqrt(max(covariance[6, 6], 0.0))), float(angle), float(turning), len(x))


def _freedom(model: Reconstruction, points: np.ndarray, side: np.ndarray, middle: np.ndarray) -> float:
    """Standard deviation of the logarithm of one side's scale, if both are rigid and only the points that both see hold
    them together."""
    if len(points) < 3:
        return np.inf
    seen = Observations.of(model, points)
    parts = linearise(model, seen.images, model.points[points][seen.track], seen.seen)
    offset = model.points[points][seen.track] - middle
    by_side = np.concatenate(
        [np.broadcast_to(np.eye(3), (len(offset), 3, 3)), -_cross(offset), offset[:, :, None]], axis=2
    )
    J = parts.by_point @ by_side * side[seen.images][:, None, None]
    slope = parts.by_point.transpose(0, 2, 1)
    V = sums(slope @ parts.by_point, seen.track, seen.count)
    W = sums(slope @ J, seen.track, seen.count)
    V_inverse = np.linalg.pinv(V, hermitian=True)
    information = np.einsum("mia,mib->ab", J, J) - np.einsum("pia,pij,pjb->ab", W, V_inverse, W)
    noise2 = max(float(np.median(parts.residuals**2)) / 0.455, 1e-6)  # the median of chi squared with one degree
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-10, hermitian=True) * noise2
    return float(np.sqrt(max(covariance[6, 6], 0.0)) / scale[6])


def _cross(vectors: np.ndarray) -> np.ndarray:
    """[K, 3, 3] with _cross(a) @ b = a x b."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _rotation(vector: np.ndarray) -> np.ndarray:
    angle = float(np.linalg.norm(vector))
    axis = _cross((vector / max(angle, 1e-12))[None])[0]
    return np.eye(3) + np.sin(angle) * axis + (1.0 - np.cos(angle)) * axis @ axis
