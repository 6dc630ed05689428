"""The usual mistakes in poses from elsewhere, as what could be tried: what is wrong, the setting that mends it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.config import SourcesConfig
from graphgs.sources.given_mends import ORDERS, axes_flipped, inverted, reordered, rescaled

_OTHER = {"opencv": "opengl", "opengl": "opencv"}


@dataclass(frozen=True)
class Mistake:
    """A way in which poses may be wrong."""

    fits: str  # goes on "they fit ..."
    mend: str  # what a user can do
    undo: Callable[[Reconstruction], Reconstruction]  # of all given poses


def usual_mistakes(
    names: tuple[str, ...],  # of the photos with given poses
    axes: str,  # opencv or opengl: what they were read with
    settings: SourcesConfig,  # that they were read with
) -> Iterator[Mistake]:
    """What is tried, the most frequent first."""
    other = _OTHER[axes]
    yield Mistake("with the cameras' y and z axes flipped", f"use --given-axes {other}", axes_flipped)
    way = f"--set sources.given_inverse={'false' if settings.given_inverse else 'true'}"
    exchanged = "inverted, camera-to-world and world-to-camera exchanged"
    yield Mistake(exchanged, f"use {way}", lambda poses: inverted(poses, axes))
    yield Mistake(
        f"{exchanged}, and with {other} axes",
        f"use {way} --given-axes {other}",
        lambda poses: inverted(axes_flipped(poses), other),
    )
    yield from _orders(names, settings.given_order)
    for factor, size in ((0.5, "half"), (2.0, "twice")):
        yield Mistake(
            f"with intrinsics of {size} the size: theirs belong to photos of another size",
            f"use --set sources.given_scale={settings.given_scale * factor:g}",
            lambda poses, factor=factor: rescaled(poses, factor),
        )


def _orders(names: tuple[str, ...], current: str) -> Iterator[Mistake]:
    if current != "name":
        back = "use --set sources.given_order=name"
        yield Mistake("when they are listed by the photos' names", back, lambda poses: _by_name(poses, current))
        return
    for order, words in (("number", "2 before 10"), ("text", "10 before 2")):
        if (np.diff(ORDERS[order](names)) != 1).any():
            yield Mistake(
                f"when they are listed by the numbers in the photos' names ({words})",
                f"use --set sources.given_order={order}",
                lambda poses, order=order: reordered(poses, order),
            )


def _by_name(poses: Reconstruction, order: str) -> Reconstruction:
    """`reordered`, undone."""
    place = ORDERS[order](poses.names)
    pose_of = np.argsort(place)
    return replace(
        poses,
        rotations=poses.rotations[place],
        translations=poses.translations[place],
        track_images=pose_of[poses.track_images].astype(np.int32),
    )
