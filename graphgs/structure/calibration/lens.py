"""The parameters of a lens that photos may determine, their names, and the camera models that hold them."""

from dataclasses import dataclass

from graphgs.scene.camera import Camera

PARAMETERS = ("focal", "principal_point", "k1", "k2")
COORDINATES = {  # of `projection.LENS`, per parameter
    "focal": ("focal",),
    "principal_point": ("center_x", "center_y"),
    "k1": ("k1",),
    "k2": ("k2",),
}
_SIMPLE = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
TITLES = {
    "focal": "focal length",
    "principal_point": "principal point",
    "k1": "radial distortion",
    "k2": "second term of radial distortion",
}


@dataclass(frozen=True)
class LensStart:
    """What is known of a camera before its photos are asked."""

    camera: Camera  # values to start from
    focal: float  # [px] as told, or a typical one
    origin: str  # of that: "given" by the user, "EXIF" or "typical"


def refinements(parameters: tuple[str, ...]) -> list[str]:
    """What bundle adjustment has to refine for these parameters to be free, given cameras as `opened` makes them."""
    found = [name for name in ("focal", "principal_point") if name in parameters]
    return found + (["distortion"] if {"k1", "k2"} & set(parameters) else [])


def undistorted(camera: Camera) -> Camera:
    """A lens of the same focal length of which nothing else is known. Models of more terms than `PARAMETERS` stay."""
    if camera.model not in _SIMPLE:
        return camera
    focal = camera.focal_and_center[0]
    return Camera("SIMPLE_RADIAL", camera.width, camera.height, (focal, camera.width / 2, camera.height / 2, 0.0))


def opened(camera: Camera, parameters: tuple[str, ...]) -> Camera:
    """The camera in the smallest model that has these distortion terms and the ones it has values for. Models of more
    terms than `PARAMETERS` stay."""
    if camera.model not in _SIMPLE:
        return camera
    focal, _, cx, cy = camera.focal_and_center
    k1, k2 = (*camera.distortion, 0.0, 0.0)[:2]
    if "k2" in parameters or k2:
        return Camera("RADIAL", camera.width, camera.height, (focal, cx, cy, k1, k2))
    return Camera("SIMPLE_RADIAL", camera.width, camera.height, (focal, cx, cy, k1))
