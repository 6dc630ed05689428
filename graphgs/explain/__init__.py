"""Questions about a finished reconstruction, answered from what its run left: nothing is computed again."""

from graphgs.explain.artefacts import Artefacts, read_artefacts
from graphgs.explain.photo import find_photo, photo_facts
from graphgs.explain.scene import scene_facts
from graphgs.explain.words import photo_lines, scene_lines

__all__ = [
    "Artefacts",
    "find_photo",
    "photo_facts",
    "photo_lines",
    "read_artefacts",
    "scene_facts",
    "scene_lines",
]
